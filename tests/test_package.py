"""fl3d as a package: what it offers, what it loads, and its wheel in an empty environment."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import pytest
import yaml

import fl3d
from fl3d.core.errors import ConfigError, NotInstalled
from fl3d.core.extras import EXTRAS, install, lacking
from fl3d.core.shipped import PACKAGE, is_checkout, shipped
from tests.conftest import ROOT

OFFERED = {"check", "compare", "evaluate", "load_detector", "open_sweep", "run", "simulate"}
COMPUTING = (
    "hydra",
    "matplotlib",
    "mlflow",
    "numba",
    "numpy",
    "optuna",
    "omegaconf",
    "pandas",
    "pyarrow",
    "scipy",
    "torch",
)
OF_TRAIN = ("mlflow", "optuna", "sqlalchemy", "torch")


def project() -> dict[str, object]:
    """What pyproject.toml says of the project."""
    return dict(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"])


def loaded_by(code: str, *arguments: object) -> set[str]:
    """Names of the packages that are loaded after some code has run in a process of its own."""
    ending = (
        "\nimport json, sys\nprint(json.dumps(sorted({n.partition('.')[0] for n in sys.modules})))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code + ending, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_what_fl3d_offers_to_python_is_this_list() -> None:
    assert set(fl3d.__all__) == OFFERED | {"Fl3dError", "ResultsWarning", "__version__"}
    for name in OFFERED:
        offered = getattr(fl3d, name)
        assert callable(offered), name
        assert offered.__doc__, name
        assert "return" in offered.__annotations__, name
    assert set(dir(fl3d)) >= OFFERED


def test_another_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="module 'fl3d' has no attribute 'evalute'"):
        fl3d.evalute  # noqa: B018


def test_importing_fl3d_loads_nothing_and_changes_nothing() -> None:
    code = """
import os, matplotlib
matplotlib.use("svg")
before = dict(os.environ), dict(matplotlib.rcParams)
import fl3d
fl3d.open_sweep, fl3d.compare
import fl3d.reports.figures.frame, fl3d.reports.figures.boxes, fl3d.papers.course_report.figures
assert matplotlib.get_backend() == "svg"
assert before == (dict(os.environ), dict(matplotlib.rcParams))
"""
    assert "matplotlib" in loaded_by(code)
    assert not loaded_by("import fl3d") & set(COMPUTING)


def test_help_loads_nothing_that_computes() -> None:
    """Of fl3d and of every command, one after another, so that it stands in a fraction of a second."""
    code = f"""
import sys
from fl3d.cli import COMMANDS, main
for words in [["--help"], *([name, "--help"] for name in COMMANDS)]:
    main(words)
    found = {{name for name in {COMPUTING} if name in sys.modules}}
    assert not found, f"{{' '.join(words)}} loads {{found}}"
"""
    assert "fl3d" in loaded_by(code)


def test_evaluate_loads_no_more_than_it_needs(tmp_path: Path) -> None:
    labels, results = tmp_path / "label_2", tmp_path / "results"
    line = "Car 0 0 0 100 100 200 200 1.5 1.6 4 0 1.7 10 0"
    for folder, text in ((labels, line), (results, f"{line} 0.9")):
        folder.mkdir()
        (folder / "000000.txt").write_text(text + "\n")
    code = "import sys\nfrom fl3d.cli import main\nmain(['evaluate', *sys.argv[1:]])"
    others = {"hydra", "matplotlib", "omegaconf", "pandas", "pyarrow", *OF_TRAIN}
    assert not loaded_by(code, labels, results) & others


def test_what_evaluate_finds_is_a_table_and_nothing_to_count_is_an_error(tmp_path: Path) -> None:
    from fl3d.api.evaluation import NothingToCount

    labels, results, none = (tmp_path / name for name in ("label_2", "results", "none"))
    line = "Car 0 0 0 100 100 200 200 1.5 1.6 4 0 1.7 10 0"
    for folder, text in ((labels, line), (results, f"{line} 0.9"), (none, f"Tram{line[3:]}")):
        folder.mkdir()
        (folder / "000000.txt").write_text(text + "\n")
    table = fl3d.evaluate(labels, results).table
    cars = table[(table["class"] == "Car") & (table["metric"] == "3d")]
    assert cars["n_gt"].tolist() == [1, 1, 1]
    # One object reaches the first of eleven steps alone, by KITTI's rule.
    assert cars["ap_r11"].tolist() == pytest.approx([100 / 11, 100 / 11, 100 / 11])
    assert table[table["class"] == "Cyclist"]["ap_r40"].isna().all()
    with pytest.raises(NothingToCount):
        fl3d.evaluate(none, results)


@pytest.mark.parametrize("change", ["ignore_beyond=[0,-20,40,20]", "score_threshold=0.5"])
def test_a_change_that_would_do_nothing_is_refused(change: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="results are taken as they are"):
        fl3d.evaluate(tmp_path, tmp_path, changes=[change])


def test_compare_loads_nothing_of_the_extras() -> None:
    assert not loaded_by("import fl3d\nfl3d.compare") & set(OF_TRAIN)


def test_the_version_is_one() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == fl3d.__version__
    newest = re.findall(r"^## (.+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[0]
    version, _, released = newest.partition(", ")
    assert version == fl3d.__version__
    # A date once it is released, and the same one in both.
    assert released == str(citation.get("date-released", "not released yet"))
    assert "version" not in project()
    assert (PACKAGE / "py.typed").exists()


def test_the_citation_keeps_the_rules_of_its_format() -> None:
    """Citation File Format 1.2.0: a misspelt key, or an author who is neither a person nor a group, is an error."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0"
    assert {"authors", "message", "title"} <= set(citation)
    others = {"license", "references", "type", "version", "date-released"}
    assert set(citation) <= {"authors", "cff-version", "message", "title"} | others
    assert citation["license"] == project()["license"]
    for work in (citation, *citation["references"]):
        assert {"authors", "title", "type"} <= set(work)
        for author in work["authors"]:  # a group has a name alone
            assert set(author) in ({"name"}, {"family-names", "given-names"}), author


def test_extras_are_those_of_the_project() -> None:
    extras = project()["optional-dependencies"]
    assert isinstance(extras, dict)
    names = {"psycopg2": "psycopg2-binary"}
    for extra, modules in EXTRAS.items():
        own = {re.split(r"[>=<]", one)[0] for one in extras[extra]} - {"fl3d[train]"}
        assert own == {names.get(module, module) for module in modules}
    assert set(extras) == {*EXTRAS, "docs", "dev"}


def test_what_an_extra_lacks_names_the_command_that_brings_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert install("slurm") == "pip install 'fl3d[slurm]'"
    with pytest.raises(KeyError):
        install("slrum")
    said = lacking(ModuleNotFoundError("No module named 'torch.nn'", name="torch.nn"))
    assert said == "needs torch, which is not installed: pip install 'fl3d[train]'"
    assert lacking(ModuleNotFoundError("No module named 'mine'", name="mine")) is None
    assert lacking(ValueError("torch")) is None
    monkeypatch.setitem(sys.modules, "fl3d.api.detectors", None)
    monkeypatch.delitem(vars(fl3d), "load_detector", raising=False)
    with pytest.raises(ModuleNotFoundError):  # of fl3d's own: no extra would mend it
        fl3d.load_detector  # noqa: B018
    assert issubclass(NotInstalled, ImportError)


def test_a_checkout_has_its_folders_beside_the_package() -> None:
    assert is_checkout()
    assert shipped("conf") == ROOT / "conf"
    assert shipped("results") == ROOT / "results"


def test_a_protocol_read_by_its_name_is_the_one_that_hydra_composes() -> None:
    from fl3d.config.compose import compose_config
    from fl3d.config.places import options_of
    from fl3d.config.protocols import read_protocol
    from fl3d.config.settings import read_settings

    for name in options_of("protocol"):
        composed = read_settings(compose_config([f"protocol={name}", "profile=paper"])).protocol
        assert read_protocol(name).id == composed.id
        assert read_protocol(name) == composed or read_protocol(name).name == composed.name
    with pytest.raises(ConfigError, match="Did you mean 'kitti'"):
        read_protocol("kiti")


class Empty:
    """An environment that holds fl3d's wheel alone, and an empty folder to run in."""

    def __init__(self, place: Path, extra: str) -> None:
        self.folder = place / "empty"
        self.folder.mkdir()
        self.bin = place / "venv" / "bin"
        venv.create(place / "venv", with_pip=True)
        self.pip("wheel", "--no-deps", "--wheel-dir", place / "dist", ROOT)
        (wheel,) = (place / "dist").glob("fl3d-*.whl")
        self.pip("install", "--constraint", ROOT / "constraints.txt", f"{wheel}{extra}")

    def pip(self, *words: object) -> None:
        """Run this environment's pip."""
        command = [self.bin / "python", "-m", "pip", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*command, *map(str, words)], check=True, cwd=self.folder)

    def fl3d(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run fl3d in the empty folder, away from the checkout."""
        return subprocess.run(
            [str(self.bin / "fl3d"), *words],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )

    @property
    def environment(self) -> dict[str, str]:
        """Without what would lead to the checkout."""
        return {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}

    def does(self, *words: str) -> str:
        """What fl3d says that goes well."""
        done = self.fl3d(*words)
        assert done.returncode == 0, f"{words}: {done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        return done.stdout


def result_files(labels: Path, results: Path) -> None:
    """Perfect results of some labels."""
    results.mkdir()
    for file in labels.glob("*.txt"):
        lines = [
            f"{line} 0.9\n"
            for line in file.read_text().splitlines()
            if not line.startswith("DontCare")
        ]
        (results / file.name).write_text("".join(lines))


@pytest.mark.slow
def test_the_wheel_alone_evaluates_compares_and_simulates(tmp_path: Path) -> None:
    empty = Empty(tmp_path, "")
    empty.does("simulate", "street", "--frames", "8", "--no-pictures")
    labels = empty.folder / "street" / "training" / "label_2"
    for name in ("theirs", "mine"):
        result_files(labels, empty.folder / name)
    assert "| Car" in empty.does("evaluate", str(labels), "mine")
    assert "mine" in empty.does("compare", str(labels), "theirs=theirs", "mine=mine")
    refused = empty.fl3d("-m", "+sweep=gamma", "profile=tiny")
    assert refused.returncode == 2
    assert refused.stderr.strip().endswith("which is not installed: pip install 'fl3d[train]'")


@pytest.mark.slow
def test_the_wheel_runs_a_sweep_in_an_empty_folder(tmp_path: Path) -> None:
    empty = Empty(tmp_path, "[train]")
    empty.does("-m", "+sweep=gamma", "profile=tiny")
    assert "| γ |" in empty.does("tables", "profile=tiny")
    assert "simulated-quick" in empty.does("tables")  # of the scores that fl3d publishes
    made = {path.name for path in empty.folder.iterdir()}
    assert made == {"runs", "data", "out"}
    with subprocess.Popen(
        [str(empty.bin / "fl3d"), "ui", "--port", "5917"],
        cwd=empty.folder,
        env=empty.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as ui:
        assert ui.stdout is not None
        first = ui.stdout.readline()
        ui.send_signal(signal.SIGTERM)
        assert "5917" in first, first
        assert ui.wait(60) in (0, 143)
    shutil.rmtree(tmp_path / "venv")
