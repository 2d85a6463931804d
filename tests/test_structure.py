"""Imports only go down, what is pure touches no file, and each thing is known in one room."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import fl3d

PACKAGE = Path(fl3d.__file__).parent
# From the ground up; rooms on one floor do not import each other.
FLOORS = [
    {"core"},
    {"geometry"},
    {"data", "losses", "sparse", "points"},
    {"detectors", "evaluation"},
    {"simulator", "config", "store", "reports"},
    {"inspection"},
    {"runs"},
    {"inference"},
    {"training"},
    {"analysis"},
    {"sweep"},
    {"papers"},
    {"api"},
    {"commands"},
    {"cli"},
    {"__main__"},
]
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
REPORTS_STAND_ON = {"core", "geometry", "data", "evaluation"}

# Modules, or rooms, that compute and nothing else: no file, no store, no network, no Hydra.
PURE = (
    "fl3d.evaluation.at_score",
    "fl3d.evaluation.average_precision",
    "fl3d.evaluation.bootstrap",
    "fl3d.evaluation.counts",
    "fl3d.evaluation.levels",
    "fl3d.evaluation.matching",
    "fl3d.evaluation.mistaken_boxes",
    "fl3d.evaluation.mistakes",
    "fl3d.evaluation.overlaps",
    "fl3d.evaluation.pairs",
    "fl3d.evaluation.protocol",
    "fl3d.evaluation.recall",
    "fl3d.evaluation.selection",
    "fl3d.papers.beside",
    "fl3d.papers.claim",
    "fl3d.papers.course_report.report_claims",
    "fl3d.papers.course_report.sentences",
    "fl3d.papers.focal_loss.best_model_claims",
    "fl3d.papers.focal_loss.concentration_claims",
    "fl3d.papers.focal_loss.gain_claims",
    "fl3d.papers.focal_loss.loss_term_claims",
    "fl3d.papers.focal_loss.order_claim",
    "fl3d.papers.focal_loss.posterior_claims",
    "fl3d.papers.focal_loss.scratch_claims",
    "fl3d.reports",
    "fl3d.runs.design",
    "fl3d.sweep.identity",
    "fl3d.sweep.plan",
    "fl3d.sweep.standings",
    "fl3d.sweep.tree",
)
FIGURES = "fl3d.reports.figures"  # figures are written, through one module
PEN = "fl3d.reports.figures.style"
NOT_FOR_PURE = (
    "fl3d.config.compose",
    "fl3d.core.files",
    "fl3d.core.leases",
    "fl3d.runs.checkpoints",
    "fl3d.runs.finished",
    "fl3d.runs.opening",
    "fl3d.runs.plans",
    "fl3d.runs.scores",
    "fl3d.runs.spec",
    "fl3d.store",
    "hydra",
    "mlflow",
    "os",
    "shutil",
    "socket",
    "subprocess",
    "tempfile",
    "torch",
)
# Methods of paths, and functions, that touch a disk.
TOUCHES = {
    "glob",
    "is_dir",
    "is_file",
    "iterdir",
    "mkdir",
    "open",
    "read_bytes",
    "read_csv",
    "read_parquet",
    "read_text",
    "rglob",
    "savefig",
    "symlink_to",
    "to_csv",
    "to_parquet",
    "touch",
    "unlink",
    "write_bytes",
    "write_text",
}
PRINTED_NUMBERS = {"II", "III", "IV", "VI", "VII", *(f"R{number}" for number in range(1, 8))}


def modules() -> dict[str, ast.Module]:
    """Every module but the package's own, by its dotted name."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        name = ".".join(parts).removesuffix(".__init__")
        if name != "fl3d":
            found[name] = ast.parse(path.read_text())
    return found


MODULES = modules()


def room_of(module: str) -> str:
    return module.split(".")[1]


def is_in(module: str, place: str) -> bool:
    """Whether a module is another, or lies in it."""
    return module == place or module.startswith(f"{place}.")


def imported(tree: ast.AST) -> set[str]:
    """Names of the modules that a file imports, wherever in the file."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            inner = {f"{node.module}.{alias.name}" for alias in node.names} & set(MODULES)
            found |= inner or {node.module}
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found


def ours(tree: ast.AST) -> set[str]:
    return {name for name in imported(tree) if name.startswith("fl3d.")}


def texts(tree: ast.AST) -> set[str]:
    """Every text that a module holds, docstrings among them."""
    constants = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return {value for value in constants if isinstance(value, str)}


def called(tree: ast.AST) -> Iterator[str]:
    """Names of functions and methods that are called."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            yield node.func.attr
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            yield node.func.id


def test_no_import_is_relative_or_of_everything() -> None:
    for name, tree in MODULES.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, name
                assert [alias.name for alias in node.names] != ["*"], name


def test_every_room_has_a_floor() -> None:
    assert {room_of(name) for name in MODULES} == set(FLOOR)


def test_imports_only_go_down() -> None:
    wrong = []
    for name, tree in MODULES.items():
        room = room_of(name)
        for other in ours(tree):
            if room_of(other) != room and FLOOR[room_of(other)] >= FLOOR[room]:
                wrong.append(f"{name} imports {other}")
    assert not wrong


def test_no_import_cycles() -> None:
    graph = {name: ours(tree) for name, tree in MODULES.items()}
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " -> ".join([*above, name])
        if name not in done:
            for other in graph.get(name, ()):
                visit(other, (*above, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_reports_know_no_paper_and_no_store() -> None:
    for name, tree in MODULES.items():
        if room_of(name) == "reports":
            assert {room_of(other) for other in ours(tree)} <= REPORTS_STAND_ON | {"reports"}, name


def test_papers_are_known_to_nobody_below() -> None:
    users = {
        room_of(name)
        for name, tree in MODULES.items()
        if any(room_of(o) == "papers" for o in ours(tree))
    }
    assert users <= {"papers", "api", "commands"}


def test_a_paper_does_not_know_another() -> None:
    folders = {name for name in MODULES if name.count(".") == 2 and f"{name}.paper" in MODULES}
    assert folders == {"fl3d.papers.focal_loss", "fl3d.papers.course_report"}
    for name, tree in MODULES.items():
        own = {folder for folder in folders if is_in(name, folder)}
        others = {other for other in ours(tree) for folder in folders - own if is_in(other, folder)}
        assert not own or not others, f"{name} imports {others}"


@pytest.mark.parametrize("place", PURE)
def test_pure_modules_compute_and_nothing_else(place: str) -> None:
    inside = {name: tree for name, tree in MODULES.items() if is_in(name, place)}
    assert inside, f"no module {place}"
    for name, tree in inside.items():
        if name == PEN:
            continue
        wrong = [
            other for other in imported(tree) for banned in NOT_FOR_PURE if is_in(other, banned)
        ]
        assert not wrong, f"{name} imports {wrong}"
        touched = set(called(tree)) & TOUCHES
        assert not touched, f"{name} calls {touched}"


def test_only_one_module_of_the_figures_writes() -> None:
    """The others draw, and hand over what is drawn."""
    assert {"save", "write_data"} <= {
        n.name for n in ast.walk(MODULES[PEN]) if isinstance(n, ast.FunctionDef)
    }
    users = {name for name, tree in MODULES.items() if "savefig" in set(called(tree))}
    assert users == {PEN}
    drawing = {
        name
        for name, tree in MODULES.items()
        if any(is_in(other, "matplotlib") for other in imported(tree))
    }
    pens = {
        name for name in drawing if any(other == "fl3d.core.files" for other in ours(MODULES[name]))
    }
    assert pens == {PEN}


def test_the_core_knows_no_table_of_a_paper() -> None:
    wrong = [
        f"{name}: {text}"
        for name, tree in MODULES.items()
        if not is_in(name, "fl3d.papers")
        for text in texts(tree) & PRINTED_NUMBERS
    ]
    assert not wrong


def test_only_the_store_knows_mlflow() -> None:
    for name, tree in MODULES.items():
        if is_in(name, "fl3d.store.mlflow"):
            continue
        assert not any(is_in(other, "mlflow") for other in imported(tree)), name
        assert not any(text.startswith("mlflow.") for text in texts(tree)), name


def test_only_runs_knows_the_files_of_a_run_folder() -> None:
    """Neither their names, nor what is in a stage's spec."""
    files = {"stage.json", "done.json", "progress.json", "error.txt", "lease.json"}
    for name, tree in MODULES.items():
        if not is_in(name, "fl3d.runs"):
            assert not texts(tree) & files, name
            assert not list(keys_of_keys(tree, "stage", "config")), name


def keys_of_keys(tree: ast.AST, outer: str, inner: str) -> Iterator[ast.Subscript]:
    """Places where a key of a key is looked up: ``written["stage"]["config"]``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Subscript):
            keys = [ast.unparse(part) for part in (node.value.slice, node.slice)]
            if keys == [repr(outer), repr(inner)]:
                yield node


def test_only_the_layout_joins_the_folders_of_a_store() -> None:
    """``root / "stages"`` is written once."""
    folders = {"stages", "plans", "studies", "checkpoints", "detections", "windows"}
    for name, tree in MODULES.items():
        if name == "fl3d.runs.layout":
            continue
        for node in ast.walk(tree):
            if (
                isinstance(node, ast.BinOp)
                and isinstance(node.op, ast.Div)
                and isinstance(node.right, ast.Constant)
            ):
                assert node.right.value not in folders, f"{name}:{node.lineno}"


def test_a_protocol_is_read_from_a_dict_in_three_places() -> None:
    """Where a config becomes settings, where a stage's spec is read, and where one is meant by its name alone."""
    users = {
        name
        for name, tree in MODULES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "Protocol"
    }
    assert users == {"fl3d.config.protocols", "fl3d.config.settings", "fl3d.runs.spec"}


def test_every_command_is_a_file_of_its_name() -> None:
    from fl3d.cli import COMMANDS, TRAIN

    files = {
        name.rpartition(".")[2]
        for name in MODULES
        if is_in(name, "fl3d.commands") and name.count(".") == 2
    }
    assert set(COMMANDS) | {TRAIN, "parsing"} == files
    for command in (*COMMANDS, TRAIN):
        body = MODULES[f"fl3d.commands.{command}"].body
        assert "run" in {node.name for node in body if isinstance(node, ast.FunctionDef)}, command


def test_every_command_loads_what_it_computes_with_when_its_words_are_read() -> None:
    """Hydra's own command, which reads configs to know its words, says itself when it has loaded all."""
    from fl3d.cli import COMMANDS

    for command in COMMANDS:
        assert "loading" in set(called(MODULES[f"fl3d.commands.{command}"])), command
