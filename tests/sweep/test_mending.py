"""A stage that is done, and whose files were torn afterwards."""

from pathlib import Path

from tests.support import run_small, small_sweep

POINTS = [["detector=voxelnet", f"loss.gamma={gamma}"] for gamma in (0, 2)]


def test_a_parent_whose_last_checkpoint_is_torn_is_mended(simulated: Path, tmp_path: Path) -> None:
    """It resumes from the checkpoint before, to the same bits."""
    common = ("schedule.stages.warmup.epochs=3", "store.keep_every=1")
    run_small(small_sweep(simulated, tmp_path, POINTS[:1], *common))
    prepared = small_sweep(simulated, tmp_path, POINTS, *common)
    parent = prepared.layout.run(prepared.plan.trials[0].stages[0])
    last = parent.steps()[-1]
    whole = parent.weights(last).read_bytes()
    parent.weights(last).write_bytes(whole[: len(whole) // 2])
    ran = run_small(prepared)
    assert sorted(ran.outcome.trained) == sorted([parent.key, prepared.plan.trials[1].key])
    assert parent.weights(last).read_bytes() == whole
