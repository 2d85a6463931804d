"""The house: imports only go down, and no room is without a floor."""

import ast
from pathlib import Path

import fl3d

PACKAGE = Path(fl3d.__file__).parent
# From the ground up; rooms on one floor do not import each other.
FLOORS = [
    {"errors"},
    {"records", "files", "provenance", "digests"},
    {"geometry", "config", "leases"},
    {"data", "losses", "sparse", "points"},
    {"detectors", "evaluation"},
    {"training"},
    {"store", "reports"},
    {"results"},
    {"sweep", "rescore"},
    {"pipeline", "preview", "gains", "evidence", "cleaning", "predict"},
    {"paper"},
    {"cli"},
    {"__main__"},
]
FLOOR = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}


def modules() -> list[Path]:
    return [path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"]


def imported(path: Path) -> set[str]:
    """Names of fl3d's modules that a file imports, wherever in the file."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("fl3d."):
            found.add(node.module)
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.startswith("fl3d.")}
    return found


def test_every_room_has_a_floor() -> None:
    assert {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in modules()} == set(FLOOR)


def test_imports_only_go_down() -> None:
    wrong = []
    for path in modules():
        room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        for name in imported(path):
            other = name.split(".")[1]
            if other != room and FLOOR[other] >= FLOOR[room]:
                wrong.append(f"{path.relative_to(PACKAGE)} imports {name}")
    assert not wrong


def test_no_import_cycles() -> None:
    graph = {}
    for path in modules():
        name = "fl3d." + ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        graph[name.removesuffix(".__init__")] = imported(path)
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " -> ".join([*above, name])
        if name not in done:
            for other in graph.get(name, ()):
                visit(other, (*above, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_only_the_store_knows_mlflow() -> None:
    users = {p.parent.name for p in modules() if "import mlflow" in p.read_text() or "from mlflow" in p.read_text()}
    assert users == {"store"}
