"""Where a sweep writes is looked at before anything is made; a disk that fills up later loses nothing."""

import errno
from collections.abc import Callable
from pathlib import Path

import pytest

from fl3d.config.settings import read_settings
from fl3d.core.errors import ConfigError, StageFailed, StoreError
from fl3d.runs.layout import StoreFolder
from fl3d.store.mlflow.connection import outages
from fl3d.sweep.places import check_places
from tests.support import keeps_locks, run_small, small_config, small_sweep

POINT = ["detector=voxelnet", "loss.gamma=0"]
Refuse = Callable[[Path, int], None]


@pytest.fixture
def refuse(monkeypatch: pytest.MonkeyPatch) -> Refuse:
    """Let the system refuse to write below a folder: root may write anywhere, so that modes do not tell."""
    write = Path.write_bytes

    def below(folder: Path, number: int) -> None:
        def refusing(path: Path, content: bytes) -> int:
            if path.is_relative_to(folder):
                raise OSError(number, "refused by the test")
            return write(path, content)

        monkeypatch.setattr(Path, "write_bytes", refusing)

    return below


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EACCES])
@pytest.mark.parametrize(
    ("key", "place"),
    [
        ("store.root", "runs"),
        ("store.root", "runs/stages"),
        ("store.root", "runs/plans"),
        ("results", "results/simulated-tiny"),
        ("results", "results/simulated-tiny/tables"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_at_the_start(
    key: str, place: str, number: int, simulated: Path, tmp_path: Path, refuse: Refuse
) -> None:
    (tmp_path / place).mkdir(parents=True)
    refuse(tmp_path / place, number)
    message = (
        rf"^{key}: {tmp_path}/{place} cannot be written \(refused by the test\); .*{key}=FOLDER"
    )
    with pytest.raises(ConfigError, match=message):
        small_sweep(simulated, tmp_path, [POINT])


def test_a_place_that_is_not_there_yet_is_looked_at_where_it_will_be(
    simulated: Path, tmp_path: Path, refuse: Refuse
) -> None:
    check_places(read_settings(small_config(simulated, tmp_path)))
    assert list(tmp_path.iterdir()) == []
    refuse(tmp_path, errno.EROFS)
    with pytest.raises(ConfigError, match=rf"^store\.root: {tmp_path} cannot be written"):
        check_places(read_settings(small_config(simulated, tmp_path)))


def test_frames_are_not_simulated_into_a_file(simulated: Path, tmp_path: Path) -> None:
    (tmp_path / "data").touch()
    words = ["data.generate=true", f"data.root={tmp_path / 'data'}"]
    with pytest.raises(ConfigError, match=r"^data\.root: .*/data cannot be written \(Not a dir"):
        small_sweep(simulated, tmp_path, [[*POINT, *words]])


def test_a_database_of_somebody_else_is_refused_at_the_start(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = read_settings(small_config(simulated, tmp_path))
    settings.store.root.mkdir()
    (settings.store.root / "mlflow.db").touch()

    monkeypatch.setattr("fl3d.core.files.os.access", lambda path, mode: False)
    with pytest.raises(ConfigError, match=r"^store\.root: .*mlflow\.db cannot be written \(Perm"):
        check_places(settings)


def test_a_look_at_a_database_leaves_locks_on_it_alone(simulated: Path, tmp_path: Path) -> None:
    settings = read_settings(small_config(simulated, tmp_path))
    settings.store.root.mkdir()
    assert keeps_locks(settings.store.root / "mlflow.db", lambda: check_places(settings))


def test_a_disk_that_fills_up_keeps_what_was_trained_and_resumes(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even why it ended can be written; the next start goes on from the checkpoint that was whole."""
    prepared = small_sweep(simulated, tmp_path, [POINT])
    layout = StoreFolder(tmp_path / "runs")
    warmup = layout.run(prepared.plan.trials[0].stages[0])
    is_full = False
    replace = Path.replace

    def refusing(path: Path, target: Path) -> Path:
        nonlocal is_full
        is_full |= target == warmup.detections(4)
        if is_full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return replace(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", refusing)
        with pytest.raises(StageFailed) as found:
            run_small(prepared)
    assert f"{warmup.path}: cannot be written (No space left on device); what is" in str(
        found.value
    )
    assert "Traceback" not in str(found.value)
    assert warmup.steps() == [2]
    ran = run_small(small_sweep(simulated, tmp_path, [POINT]))
    assert ran.outcome.trained == list(prepared.plan.stages)
    assert warmup.steps() == [2, 4]


@pytest.mark.parametrize(
    "words", ["database or disk is full", "attempt to write a readonly database"]
)
def test_a_database_that_takes_no_more_is_not_waited_for(words: str) -> None:
    import sqlalchemy as sa

    error = sa.exc.OperationalError("INSERT", {}, Exception(words))
    with pytest.raises(StoreError, match=rf"cannot be written \({words}\)") as found, outages():
        raise error
    assert type(found.value) is StoreError  # no outage, which the recorder would wait for
