"""A store that was moved: tables, gains, why, verify, resume and MLflow's artifacts, wherever it lies now."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from mlflow import MlflowClient
from mlflow.tracking._tracking_service import utils

from fl3d.analysis.found import judge_sweep
from fl3d.analysis.trace import trace
from fl3d.analysis.verify import verify
from fl3d.config.settings import read_settings
from fl3d.core.errors import DataError, DataMissing
from fl3d.papers.results import write_sweep
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import StoreFolder
from fl3d.runs.opening import open_sweep
from fl3d.runs.spec import read_spec
from fl3d.store.mlflow.tracking import MlflowStore
from fl3d.store.opening import open_store
from tests.support import run_small, small_config, small_sweep

POINTS = [["detector=voxelnet", f"loss.gamma={gamma}"] for gamma in (0, 2)]
OLD_FORM = ("from_store", "labels_digest")  # what specs had not when fl3d began


def opened(project: Path, data: Path | None = None) -> FinishedSweep:
    """The sweep of a project, as a command opens it that is given where the data are."""
    config = small_config(data or project / "data", project, "detector=voxelnet")
    return open_sweep(read_settings(config))


def resume(project: Path, *common: str) -> list[str]:
    """Start the sweep again, with its scores in MLflow; keys of the stages that it trains."""
    prepared = small_sweep(project / "data", project, POINTS, *common)
    store = prepared.settings.store
    return run_small(prepared, store=open_store(store.root, store.uri)).outcome.trained


def change_labels(data: Path) -> None:
    """As if a folder held somebody else's frames of the same names."""
    for path in (data / "training" / "label_2").glob("*.txt"):
        path.write_text(path.read_text().replace("Car", "Van"))


def in_old_form(project: Path) -> None:
    """A store as it was written before specs had paths as seen from the store."""
    for path in (project / "runs" / "stages").glob("*/stage.json"):
        content = json.loads(path.read_text())
        content.pop(OLD_FORM[0])
        content["machine"].pop(OLD_FORM[1])
        path.write_text(json.dumps(content))


@pytest.fixture(scope="module")
def trained(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project, ``data`` and ``runs``, whose sweep was run to its end."""
    project = tmp_path_factory.mktemp("trained") / "project"
    shutil.copytree(simulated, project / "data")
    resume(project)
    return project


@pytest.fixture
def moved(trained: Path, tmp_path: Path) -> Iterator[tuple[Path, Path]]:
    """Where the project lies now, and where it lay: there somebody has put a file, so that no folder can be made."""
    project = tmp_path / "elsewhere" / "another name"
    shutil.copytree(trained, project)
    aside = trained.with_name("aside")
    trained.rename(aside)
    trained.write_text("somebody's")
    yield project, trained
    assert trained.read_text() == "somebody's"
    trained.unlink()
    aside.rename(trained)


def test_a_moved_store_is_read_where_it_lies_now(moved: tuple[Path, Path]) -> None:
    """Tables, gains, why and verify, with the digits that it had; it says so itself, or the words of the sweep do."""
    project, before = moved
    assert read_spec(opened(project).trials[0].folder).kitti().root == project / "data"
    in_old_form(project)
    sweep = opened(project)
    assert sweep.kitti().root == project / "data"
    assert not verify(sweep, from_weights=True).wrong
    tables, written = write_sweep(sweep, lambda table: [sweep], lambda line: None)
    assert tables
    assert all(path.is_relative_to(project / "results") for path in written)
    assert set(judge_sweep(sweep).gains["level"]) == {"0", "2"}
    runs = sweep.runs()
    for _, row in sweep.select("last").iterrows():
        text = "\n".join(trace(sweep, row, "ap_3d/moderate", runs[str(row["trial"])]))
        assert text.count("matches") == 2
        assert "NOT" not in text
        assert str(before) not in text
        assert f"data        {project / 'data'}, 4 validation frames" in text


def test_a_moved_store_shows_its_artifacts_and_resumes(moved: tuple[Path, Path]) -> None:
    """Those of the old runs, and of a trial that is trained after the move, lie where the store lies now."""
    project, before = moved
    in_old_form(project)
    sweep = opened(project)
    lost = sweep.trials[1]
    shutil.rmtree(lost.folder.path)
    assert resume(project) == [lost.key]
    sweep = opened(project)
    assert not verify(sweep, from_weights=False).wrong
    utils._artifact_repos_cache.clear()  # this process knows where they were
    client = MlflowClient(MlflowStore(project / "runs").uri)
    experiment = client.get_experiment_by_name(sweep.settings.experiment)
    assert (
        experiment.artifact_location
        == (project / "runs" / "artifacts" / sweep.settings.experiment).as_uri()
    )
    found = client.search_runs([experiment.experiment_id])
    assert len(found) == 2
    for run in found:
        config = json.loads(
            Path(client.download_artifacts(run.info.run_id, "config.json")).read_text()
        )
        assert config["seed"] == 0
        assert Path(client.download_artifacts(run.info.run_id, "pictures/birds_eye.png")).exists()
    models = client.search_logged_models([experiment.experiment_id])
    assert len(models) == 4
    for model in models:
        assert str(before) not in model.artifact_location
        assert [file.path for file in client.list_logged_model_artifacts(model.model_id)]


def test_stages_find_frames_that_moved_with_the_store(trained: Path, tmp_path: Path) -> None:
    """Though nobody says where they are, and though others lie where they were."""
    project = tmp_path / "project"
    shutil.copytree(trained, project)
    for run in StoreFolder(project / "runs").runs():
        assert read_spec(run).kitti().root == project / "data"
    change_labels(project / "data")
    for run in StoreFolder(project / "runs").runs():
        assert read_spec(run).kitti().root == trained / "data"  # these are still the right ones


def test_a_store_alone_may_move_away_from_its_data(trained: Path, tmp_path: Path) -> None:
    shutil.copytree(trained / "runs", tmp_path / "runs")
    sweep = opened(tmp_path, data=trained / "data")
    assert not verify(sweep, from_weights=False).wrong
    assert opened(tmp_path, data=tmp_path / "nowhere").kitti().root == trained / "data"


def test_a_linked_store_and_linked_data_have_not_moved(trained: Path, tmp_path: Path) -> None:
    """MLflow's paths stay as they are: whoever opens the store by its own name finds them right."""
    for name in ("runs", "data"):
        (tmp_path / name).symlink_to(trained / name)
    assert resume(tmp_path) == []
    client = MlflowClient(MlflowStore(trained / "runs").uri)
    location = client.search_experiments(filter_string="name LIKE 'trials%'")[0].artifact_location
    assert location.startswith((trained / "runs").as_uri())


def test_frames_of_somebody_else_are_not_taken_for_the_sweeps(
    trained: Path, tmp_path: Path
) -> None:
    project = tmp_path / "project"
    shutil.copytree(trained, project)
    change_labels(project / "data")
    with pytest.raises(DataError, match=r"data: holds other labels .*give data\.root=FOLDER"):
        opened(project).kitti()


def test_frames_that_are_gone_are_asked_for(moved: tuple[Path, Path]) -> None:
    project, before = moved
    shutil.rmtree(project / "data")
    spec = read_spec(opened(project).trials[0].folder)
    message = rf"data: the frames of .* are not there: they lay in {before}/data; give data\.root"
    with pytest.raises(DataMissing, match=message):
        spec.kitti(project / "data")


def test_modules_that_moved_with_the_store_are_found(trained: Path, tmp_path: Path) -> None:
    from dataclasses import replace

    from fl3d.runs.spec import write_spec

    project = tmp_path / "project"
    shutil.copytree(trained, project)
    run = StoreFolder(project / "runs").runs()[0]
    spec = read_spec(run)
    (project / "mine").mkdir()
    write_spec(run, replace(spec, machine=replace(spec.machine, modules=(str(project / "mine"),))))
    assert read_spec(run).machine.modules == (str(project / "mine"),)
    again = tmp_path / "again"
    project.rename(again)
    here = StoreFolder(again / "runs").run(run.key)
    assert read_spec(here).machine.modules == (str(again / "mine"),)
    (again / "mine").rmdir()
    assert read_spec(here).machine.modules == (str(project / "mine"),)


def test_a_place_in_a_stages_folder_is_told_whatever_it_was_written_as(tmp_path: Path) -> None:
    run = StoreFolder(tmp_path / "runs").run("key")
    inside = run.path / "work" / "epoch_1"
    assert run.here("work/epoch_1") == inside
    assert run.here("/old/runs/stages/key/work/epoch_1") == inside
    assert run.here("/exp/epoch_1") == Path("/exp/epoch_1")
    assert run.here("/old/runs/stages/other/work/epoch_1") == Path(
        "/old/runs/stages/other/work/epoch_1"
    )
