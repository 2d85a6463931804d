"""What every store keeps to: each score once, one run a trial and protocol, read as one frame."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from fl3d.store.base import RunStatus, Scored, Store
from fl3d.store.memory import MemoryStore
from fl3d.store.mlflow.tracking import MlflowStore

TAGS = {"detector": "VoxelNet"}
PARAMS = {"loss.gamma": 2.0, "seed": 0}
APS = {"ap_3d/moderate": 50.0, "ap_3d/easy": 60.0}
DATA = ("simulated", "abc")


class Inside:
    """Looks into a store, past its interface, which reads back nothing but scores."""

    def __init__(self, store: Store) -> None:
        self.store = store

    def tags(self, run: str) -> Mapping[str, str]:
        if isinstance(self.store, MemoryStore):
            return self.store.runs[run].tags
        return self._mlflow.client.get_run(run).data.tags

    def params(self, run: str) -> Mapping[str, str]:
        if isinstance(self.store, MemoryStore):
            return {key: str(value) for key, value in self.store.runs[run].params.items()}
        return self._mlflow.client.get_run(run).data.params

    def status(self, run: str) -> str:
        if isinstance(self.store, MemoryStore):
            return self.store.runs[run].status.name
        names = {"FINISHED": "DONE", "KILLED": "STOPPED"}
        status = self._mlflow.client.get_run(run).info.status
        return names.get(status, status)

    def models(self, experiment: str) -> list[tuple[str, str]]:
        """Name and step of each model."""
        if isinstance(self.store, MemoryStore):
            runs = [run for run in self.store.runs.values() if run.experiment == experiment]
            return [(name, tags["step"]) for run in runs for name, tags in run.models.items()]
        models = self._mlflow.client.search_logged_models([experiment])
        return [(model.name, model.tags["step"]) for model in models]

    def files(self, run: str, folder: str) -> list[str]:
        if isinstance(self.store, MemoryStore):
            return self.store.runs[run].files[folder]
        found = self._mlflow.client.list_artifacts(run, folder)
        return [Path(file.path).name for file in found if not file.is_dir]

    def datasets(self, run: str) -> list[tuple[str, str]]:
        if isinstance(self.store, MemoryStore):
            dataset = self.store.runs[run].dataset
            return [dataset] if dataset else []
        inputs = self._mlflow.client.get_run(run).inputs.dataset_inputs
        return [(one.dataset.name, one.dataset.digest) for one in inputs]

    @property
    def _mlflow(self) -> MlflowStore:
        assert isinstance(self.store, MlflowStore)
        return self.store


@pytest.fixture(scope="module", params=[MemoryStore, MlflowStore])
def store(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Store:
    made: Store = request.param(tmp_path_factory.mktemp("store"))
    made.open()
    made.open()  # every call may be made again
    return made


def run_of(store: Store, experiment: str, trial: str = "trial-a", protocol: str = "paper-1") -> str:
    return store.run(store.experiment(experiment, ""), trial, protocol, "a", TAGS, PARAMS)


def test_scores_come_back_as_they_went_in(store: Store) -> None:
    run = run_of(store, "in-and-out")
    store.log(run, Scored(100, 1_000, {**APS, "epoch": 1}))
    store.log(
        run, Scored(200, 2_000, {"ap_3d/moderate": 0.1 + 0.2, "ap_3d/easy": 1e-9, "epoch": 2})
    )
    frame = store.read("in-and-out")
    assert {"run", "trial", "protocol", "step", "epoch", *APS} <= set(frame)
    assert frame["run"].tolist() == [run, run]
    assert frame["trial"].tolist() == ["trial-a", "trial-a"]
    assert frame["protocol"].tolist() == ["paper-1", "paper-1"]
    assert frame["step"].tolist() == [100, 200]
    assert frame["epoch"].tolist() == [1, 2]
    assert frame["ap_3d/moderate"].tolist() == [50.0, 0.1 + 0.2]
    assert frame["ap_3d/easy"].tolist() == [60.0, 1e-9]


def test_a_score_that_is_logged_again_is_kept_once(store: Store) -> None:
    run = run_of(store, "once")
    for _ in range(3):
        store.log(run, Scored(100, 1_000, APS))
    assert store.logged_steps(run) == {100}
    assert store.read("once")["step"].tolist() == [100]


def test_a_trial_has_one_run_for_each_protocol(store: Store) -> None:
    runs = [run_of(store, "runs", protocol=one) for one in ("paper-1", "paper-1", "paper-2")]
    assert runs[0] == runs[1]
    assert runs[1] != runs[2]
    for number, run in enumerate(runs[1:]):
        store.log(run, Scored(100, 1_000, {"ap_3d/moderate": float(number)}))
    frame = store.read("runs").set_index("protocol")
    assert frame["ap_3d/moderate"].to_dict() == {"paper-1": 0.0, "paper-2": 1.0}


def test_sweeps_are_kept_apart(store: Store) -> None:
    for name in ("one", "other"):
        store.log(run_of(store, name), Scored(100, 1_000, APS))
    assert len(store.read("one")) == 1
    assert run_of(store, "one") != run_of(store, "other")


def test_a_run_tells_tags_and_config(store: Store) -> None:
    run = run_of(store, "told")
    store.set_tags(run, {"last_step": "200"})
    assert store.read("told").empty
    tags = Inside(store).tags(run)
    assert tags["detector"] == "VoxelNet"
    assert tags["last_step"] == "200"
    assert Inside(store).params(run) == {"loss.gamma": "2.0", "seed": "0"}


def test_an_interrupted_run_is_opened_again(store: Store) -> None:
    for status in (RunStatus.STOPPED, RunStatus.FAILED):
        run = run_of(store, f"again-{status.value}")
        store.end(run, status)
        assert Inside(store).status(run) == status.name
        assert not store.is_finished(run)
        assert run_of(store, f"again-{status.value}") == run
        assert Inside(store).status(run) == "RUNNING"


def test_a_run_that_is_done_is_known_and_stays_done(store: Store) -> None:
    run = run_of(store, "closed")
    assert not store.is_finished(run)
    for _ in range(2):
        store.end(run, RunStatus.DONE)
        assert store.is_finished(run)
        assert run_of(store, "closed") == run
        assert store.is_finished(run)


def test_an_unknown_sweep_is_an_empty_frame(store: Store) -> None:
    assert store.read("never").empty


def test_a_sweep_without_scores_is_an_empty_frame(store: Store) -> None:
    run_of(store, "silent")
    assert store.read("silent").empty


def test_a_model_is_made_once_and_replaced_when_its_checkpoint_is_another(
    store: Store, tmp_path: Path
) -> None:
    experiment = store.experiment("models", "")
    run = run_of(store, "models")
    scored = Scored(100, 1_000, APS)
    store.log(run, scored)
    weights = tmp_path / "best.pt"
    weights.write_bytes(b"weights")

    def log(name: str, step: str) -> str:
        tags = {"step": step}
        return store.log_model(experiment, run, name, [weights], tags, scored, DATA)

    assert log("best", "100") == log("best", "100")
    log("last", "300")
    assert sorted(Inside(store).models(experiment)) == [("best", "100"), ("last", "300")]
    log("best", "200")
    assert sorted(Inside(store).models(experiment)) == [("best", "200"), ("last", "300")]
    assert store.read("models")["step"].tolist() == [100]  # a model's scores are not the run's


def test_a_store_says_which_models_it_holds(store: Store, tmp_path: Path) -> None:
    experiment = store.experiment("which models", "")
    run = run_of(store, "which models")
    assert store.models(experiment) == set()
    weights = tmp_path / "best.pt"
    weights.write_bytes(b"weights")
    for name in ("best", "last"):
        store.log_model(experiment, run, name, [weights], {}, Scored(100, 1_000, APS), DATA)
    assert store.models(experiment) == {(run, "best"), (run, "last")}


def test_files_of_one_name_are_overwritten(store: Store, tmp_path: Path) -> None:
    run = run_of(store, "files")
    (tmp_path / "table.md").write_text("| 1 |")
    for _ in range(2):
        store.log_files(run, [tmp_path / "table.md"], "tables")
    assert Inside(store).files(run, "tables") == ["table.md"]


def test_runs_without_a_file_are_told(store: Store, tmp_path: Path) -> None:
    """Those that have it may be told too, where a store does not know; those that lack it always are."""
    run, other = (run_of(store, "without", trial) for trial in ("a", "b"))
    file = tmp_path / "page.html"
    file.write_text("one")
    store.log_files(run, [file], "results")
    assert other in store.without([run, other], file, "results")
    file.write_text("two")
    assert store.without([other, run, run], file, "results") == sorted([run, other])


def test_a_dataset_is_linked_once(store: Store, tmp_path: Path) -> None:
    run = run_of(store, "data")
    for _ in range(2):
        store.link_dataset(run, *DATA, tmp_path)
    assert Inside(store).datasets(run) == [DATA]


def test_a_store_knows_its_root_by_an_id_that_stays(store: Store) -> None:
    assert store.exists
    assert store.id == type(store)(store.root).id
