"""One tiny sweep from scratch to its tables, as a user runs it: interrupted, resumed, run again.

The golden tables are of the arithmetic of some kinds of processor; others round otherwise, which moves
cells by as much as a seed does. Cells are compared within TOLERANCE of one set of them, whole, and a
processor whose arithmetic is of none of them has nothing to compare with. When a change moves them,
write here what and why, and regenerate with `python tests/test_end_to_end.py`.

History of the golden tables:
  1. first version.
  2. simulator 2: other frames.
  3. VoxelNet computes its heads as matrix products, and looks at frames in batches of two: other
     rounding.
  4. a second set, of a processor with AVX-512 and AMX: the same code gives VoxelNet a BEV AP easy of
     44.8 (gamma = 0) on the first machine and 31.6 on this one. 3D-FCN's are the same digits on both.
  5. Table IV looks at all weights; what it was, the best of the last stage alone, is a table of its own.
     No number moved.
  6. VoxelNet 3 and 3D-FCN 2 normalise and convolve with other rounding, and 3D-FCN's batches have other
     layouts. The second set is made anew. The processor of the first was not at hand; in its place is a
     set of the second processor held to AVX2 (ATEN_CPU_CAPABILITY=avx2 ONEDNN_MAX_CPU_ISA=AVX2
     MKL_ENABLE_INSTRUCTIONS=AVX2).
  7. VoxelNet 4 and 3D-FCN 3 convolve few channels pair by pair. Two sets of an EPYC of the Zen 4 kind, as it
     is and held to AVX2, in the place of those of the Xeon, which was not at hand. Processors are told
     apart by their model too: the EPYC had the Xeon's digest, and VoxelNet's cells up to 12 AP off.
"""

import os
import platform
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from fl3d.papers.index import write_index
from fl3d.reports.table import AP_COLUMNS

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "tests" / "golden"
KINDS = {  # where the tables of a kind of processor lie, by its model and its arithmetic
    "AuthenticAMD-25-17-28e1953a095a": GOLDEN / "zen4",
    "AuthenticAMD-25-17-8355e7caf1c3": GOLDEN / "zen4_avx2",
}
ARITHMETIC = """
import hashlib, torch
torch.manual_seed(0)
x = torch.randn(2, 16, 6, 20, 20)
parts = [torch.nn.Conv3d(16, 16, 3)(x), torch.nn.Conv2d(16, 32, 3)(x[:, :, 0])]
parts.append(torch.randn(300, 77) @ torch.randn(77, 50))
whole = b"".join(one.detach().numpy().tobytes() for one in parts)
print(hashlib.sha256(whole).hexdigest()[:12])
"""
GOLDEN_TABLES = ("II", "III", "IV_last_stage")
TOLERANCE = 3.0  # AP; a single R11 step is 9
GAMMAS = "loss.gamma=0,2"


def command(work: Path, *extra: str) -> list[str]:
    places = [f"store.root={work}/runs", f"results={work}/results", f"data.root={work}/data"]
    return [
        sys.executable,
        "-m",
        "fl3d",
        "-m",
        "+sweep=gamma",
        "profile=tiny",
        GAMMAS,
        *places,
        *extra,
    ]


def run(arguments: list[str]) -> str:
    done = subprocess.run(
        arguments, capture_output=True, text=True, cwd=ROOT, check=False, timeout=600
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def arithmetic() -> str:
    """Model of this processor, and a digest of some of torch's products, on one thread as stages have it.

    The digest tells what a processor is held to by the environment, and the model how caches divide larger products.
    """
    done = subprocess.run(
        [sys.executable, "-c", ARITHMETIC],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    return f"{model()}-{done.stdout.strip()}"


def model() -> str:
    """Maker, family and model of this processor; what the platform says where Linux does not tell."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    told = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    return "-".join(told.get(key, "") for key in ("vendor_id", "cpu family", "model"))


def members(group: int) -> list[str]:
    """Processes of a process group."""
    done = subprocess.run(["pgrep", "-g", str(group)], capture_output=True, text=True, check=False)
    return done.stdout.split()


def tables(work: Path) -> dict[str, bytes]:
    folder = work / "results" / "simulated-tiny"
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A sweep that was never disturbed."""
    work = tmp_path_factory.mktemp("whole")
    return work, run(command(work))


def test_it_says_what_it_does_and_prints_the_tables(finished: tuple[Path, str]) -> None:
    _, said = finished
    assert "4 trials in 6 stages" in said
    for title in ("**Table II.**", "**Table III.**", "**Table IV.**"):
        assert title in said
    assert "fl3d ui" in said


def test_the_tables_are_the_golden_ones(finished: tuple[Path, str]) -> None:
    """All of them those of one kind of processor: 3D-FCN's of one and VoxelNet's of another will not do."""
    kinds = list(KINDS.values())
    folder = finished[0] / "results" / "simulated-tiny" / "tables"
    aps = list(AP_COLUMNS)
    largest = dict.fromkeys(kinds, 0.0)
    for name in GOLDEN_TABLES:
        found = pd.read_csv(folder / f"table_{name}.csv")
        for kind in kinds:
            golden = pd.read_csv(kind / f"table_{name}.csv")
            front = [column for column in golden if column not in AP_COLUMNS]
            pd.testing.assert_frame_equal(found[front], golden[front])
            largest[kind] = max(largest[kind], (found[aps] - golden[aps]).abs().to_numpy().max())
            assert golden[aps].to_numpy().max() > 1  # a table of zeros would prove nothing
    if min(largest.values()) >= TOLERANCE and arithmetic() not in KINDS:
        pytest.skip(f"no tables of this processor's arithmetic; from those of others {largest}")
    assert min(largest.values()) < TOLERANCE, largest


def test_the_best_of_all_weights_is_at_least_that_of_the_last_stage(
    finished: tuple[Path, str],
) -> None:
    """In the mean of the three 3D APs that chooses."""
    folder = finished[0] / "results" / "simulated-tiny" / "tables"
    aps = [column for column in AP_COLUMNS if column.startswith("3d")]
    every, last = (pd.read_csv(folder / f"table_{name}.csv") for name in ("IV", "IV_last_stage"))
    assert every["gamma"].tolist() == last["gamma"].tolist() == [0, 2, 0, 2]
    assert (every[aps].mean(axis=1) >= last[aps].mean(axis=1) - 0.01).all()  # printed ones


def test_the_store_holds_the_whole_curve_of_every_trial(finished: tuple[Path, str]) -> None:
    connection = sqlite3.connect(finished[0] / "runs" / "mlflow.db")
    query = """SELECT r.run_uuid, COUNT(*), COUNT(DISTINCT m.step)
               FROM metrics m JOIN runs r USING (run_uuid)
               WHERE m.key = 'ap_3d/moderate' AND r.status = 'FINISHED' GROUP BY r.run_uuid"""
    rows = connection.execute(query).fetchall()
    models = connection.execute("SELECT name, COUNT(*) FROM logged_models GROUP BY name").fetchall()
    connection.close()
    assert len(rows) == 4
    assert {row[1:] for row in rows} == {
        (7, 7)
    }  # six checkpoints of the warm-up and one of its own
    assert sorted(models) == [("best", 4), ("last", 4)]


def test_run_again_it_trains_nothing_and_writes_the_same(finished: tuple[Path, str]) -> None:
    work, _ = finished
    before = tables(work)
    said = run(command(work))
    assert "everything is done" in said
    assert tables(work) == before


def test_tables_are_made_again_without_data_or_checkpoints(
    finished: tuple[Path, str], tmp_path: Path
) -> None:
    work, _ = finished
    overrides = [
        "+sweep=gamma",
        "profile=tiny",
        f"store.root={work}/runs",
        f"results={tmp_path}",
        "data.root=nowhere",
    ]
    run([sys.executable, "-m", "fl3d", "tables", *overrides])
    folder = tmp_path / "simulated-tiny"
    again = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    before = tables(work)
    differing = {name for name in before if again[name] != before[name]}
    assert {name.partition(".")[0] for name in differing} <= {
        "figures/ap_over_level_gamma"
    }  # which has intervals now
    more = {
        f"tables/table_{name}.md"
        for name in ("II_intervals", "III_published", "IV_intervals", "VI", "VII", "I")
    }
    assert more <= set(again)


def test_a_report_has_everything_on_one_page_and_in_mlflow(
    finished: tuple[Path, str], tmp_path: Path
) -> None:
    work, _ = finished
    overrides = [
        "profile=tiny",
        f"store.root={work}/runs",
        f"results={tmp_path}",
        "data.root=nowhere",
    ]
    said = run([sys.executable, "-m", "fl3d", "report", *overrides])
    folder = tmp_path / "simulated-tiny"
    assert str(folder / "report_gamma.html") in said
    page = (folder / "report_gamma.html").read_text()
    assert page.count("<img alt='Figure ") == 5  # 1 thrice: of each detector, and v1's; 4 and 5
    for word in ("Table II.", "Table VII.", "optimism", "largest gain of 3D-FCN", "commit "):
        assert word in page
    assert len(list((work / "runs" / "artifacts").rglob("results/report_gamma.html"))) == 4
    index = write_index(tmp_path).read_text()
    for name in ("figure_4", "ap_over_level_gamma", "ap_over_steps_gamma"):
        assert f"(simulated-tiny/figures/{name}.png)" in index
    assert "**Table III.**" in index
    assert "[95 % interval]" in index
    windows = pd.read_csv(folder / "figures" / "figure_5.csv")
    assert (windows.groupby(["detector", "positives", "gamma"])["count"].first() > 10).all()


@pytest.mark.parametrize(
    "how",
    [
        signal.SIGTERM,
        signal.SIGKILL,
        pytest.param(signal.SIGINT, marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, marks=pytest.mark.slow),
    ],
)
def test_interrupted_it_resumes_to_the_same_tables(
    finished: tuple[Path, str], tmp_path: Path, how: signal.Signals
) -> None:
    """Signals to the parent alone in the middle of training; after kill -9 workers end by themselves."""
    work, _ = finished
    (tmp_path / "data").symlink_to(work / "data")
    process = subprocess.Popen(
        command(tmp_path),
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT, signal.SIG_DFL
        ),  # a shell's background jobs ignore it
    )
    stages = tmp_path / "runs" / "stages"
    deadline = time.monotonic() + 300
    while not list(stages.glob("*/checkpoints/*.json")):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.1)
    os.kill(process.pid, how)
    process.wait(timeout=300)
    if how is not signal.SIGKILL:
        assert process.returncode == 128 + how
        connection = sqlite3.connect(tmp_path / "runs" / "mlflow.db")
        assert {status for (status,) in connection.execute("SELECT status FROM runs")} == {"KILLED"}
        connection.close()
        assert not list((tmp_path / "runs" / "plans").glob("*.lease"))
    while members(process.pid):  # workers notice within seconds that their parent has gone
        assert time.monotonic() < deadline, "workers outlive their parent"
        time.sleep(0.2)
    said = run(command(tmp_path))
    assert "stages to train" in said
    assert tables(tmp_path) == tables(work)


def test_tables_of_a_protocol_that_was_never_scored_are_refused(finished: tuple[Path, str]) -> None:
    """Never one protocol's AP under another's name."""
    work, _ = finished
    arguments = [
        sys.executable,
        "-m",
        "fl3d",
        "tables",
        "+sweep=gamma",
        "profile=tiny",
        "protocol=kitti",
        *command(work)[7:],
    ]
    before = tables(work)
    done = subprocess.run(
        arguments, capture_output=True, text=True, cwd=ROOT, check=False, timeout=120
    )
    assert done.returncode == 2
    assert "no scores under protocol kitti-" in done.stderr
    assert tables(work) == before


def test_stored_detections_are_scored_again_under_any_cut(finished: tuple[Path, str]) -> None:
    """At the sweep's own cut the digits are the sweep's; a cut above every score leaves nothing."""
    work, _ = finished
    places = command(work)[7:]
    said = run(
        [
            sys.executable,
            "-m",
            "fl3d",
            "rescore",
            "+sweep=gamma",
            "profile=tiny",
            *places,
            "score_threshold=0,0.3,1",
        ]
    )
    assert said.count("| γ | 0 | 0.3 | 1 |") == 2  # a table a detector
    for group in ("3D-FCN", "VoxelNet"):
        assert f"{group}, ap_3d/moderate, last models; columns: score_threshold." in said
    folder = work / "results" / "simulated-tiny" / "tables"
    path = folder / "rescored_gamma_paper_score_threshold.csv"
    scores = pd.read_csv(path)
    path.unlink()  # the tests after this one compare whole folders
    assert len(scores) == 4 * 3
    own = scores[(scores["score_threshold"] == 0) & (scores["group"] == "3D-FCN")]
    assert own["level"].tolist() == [0, 2]
    table = pd.read_csv(folder / "table_II.csv")
    assert own["ap_3d/moderate"].round(2).tolist() == table["3d_moderate"].tolist()
    assert (scores[scores["score_threshold"] == 1].filter(like="ap_").to_numpy() == 0).all()


def test_gains_come_with_intervals(finished: tuple[Path, str]) -> None:
    work, _ = finished
    said = run(
        [sys.executable, "-m", "fl3d", "gains", "+sweep=gamma", "profile=tiny", *command(work)[7:]]
    )
    assert said.count("| γ | seeds | AP | gain over γ = 0 |") == 2  # a table a detector
    assert "Verdicts on VoxelNet, 3d_r40/moderate, last models." in said
    assert "frames only, not training" in said
    folder = work / "results" / "simulated-tiny" / "tables"
    table = pd.read_csv(folder / "gains_gamma_paper.csv")
    own = table[
        (table["metric"] == "3d") & (table["average"] == "R11") & (table["group"] == "3D-FCN")
    ]
    printed = pd.read_csv(folder / "table_II.csv")["3d_moderate"].tolist()
    assert own[own["difficulty"] == "moderate"]["ap"].round(2).tolist() == printed
    drawn = (folder.parent / "figures").glob("forest_gamma.*")
    for path in [*folder.glob("*_gamma_paper.csv"), *drawn]:
        path.unlink()  # the tests after this one compare whole folders


def test_a_single_trial_is_trained_by_plain_overrides(finished: tuple[Path, str]) -> None:
    """As `python -m fl3d detector=voxelnet loss.gamma=2`; both stages are reused from the sweep."""
    work, _ = finished
    places = command(work)[7:]
    said = run(
        [sys.executable, "-m", "fl3d", "detector=voxelnet", "loss.gamma=2", "profile=tiny", *places]
    )
    assert "everything is done" in said
    assert "Last models of VoxelNet" in said
    assert "| 2 | 1 |" in said


if __name__ == "__main__":
    import shutil
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        run(command(Path(folder)))
        kind = KINDS.get(
            arithmetic(), GOLDEN / arithmetic()
        )  # a new one: name it, and put it into KINDS
        kind.mkdir(exist_ok=True)
        for name in GOLDEN_TABLES:
            shutil.copy(
                Path(folder) / "results" / "simulated-tiny" / "tables" / f"table_{name}.csv", kind
            )
