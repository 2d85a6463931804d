"""Sentences of the paper about its best models: counted, and not judged by the frames that chose them."""

from fl3d.papers.focal_loss.best_model_claims import CHOSEN, best_claim, step_claims
from fl3d.papers.focal_loss.best_models import BEST_MODELS, BEST_OWN_MODELS, improvements
from tests.papers.making import Made, aps, finished_sweep


def test_not_all_metrics_of_the_best_models_improve() -> None:
    claim = best_claim([True, False], [True, True])
    assert claim.recomputed == "11 of 12"
    assert claim.ours == "1 of 2; of the last stage alone 2 of 2"
    assert claim.verdict == f"false by one cell (VoxelNet 3D hard, 0.01); {CHOSEN}"


def test_best_models_of_ours_get_no_verdict_though_all_improve() -> None:
    made = [
        Made(overrides=(f"loss.gamma={gamma}", f"seed={seed}"), scores={1: aps(10 + 20 * gamma)})
        for gamma in (0, 1)
        for seed in range(3)
    ]
    sweep = finished_sweep(("detector=voxelnet", f"sweep.tables=[{BEST_MODELS.name}]"), made)
    claim = best_claim(*(improvements(sweep, table) for table in (BEST_MODELS, BEST_OWN_MODELS)))
    assert claim.ours == "6 of 6; of the last stage alone 6 of 6"
    assert claim.verdict.endswith(f"; {CHOSEN}")


def test_without_best_models_nothing_is_said_of_ours() -> None:
    nobody = finished_sweep(
        ("detector=voxelnet", f"sweep.tables=[{BEST_MODELS.name}]"),
        [Made(overrides=("loss.gamma=1",), scores={1: aps(10)})],
    )
    claim = best_claim(improvements(nobody, BEST_MODELS))
    assert (claim.ours, claim.verdict) == ("", "false by one cell (VoxelNet 3D hard, 0.01)")


def test_only_seeds_that_both_models_have_are_counted() -> None:
    """Gamma 0 has 10 and 90, gamma 1 has 60 in the first seed alone: its mean is higher, by seed 0 it is better."""
    trials = (("loss.gamma=0", 0, 10), ("loss.gamma=0", 1, 90), ("loss.gamma=1", 0, 20))
    made = [
        Made(overrides=(gamma, f"seed={seed}"), scores={1: aps(ap)}) for gamma, seed, ap in trials
    ]
    sweep = finished_sweep(("detector=voxelnet", f"sweep.tables=[{BEST_MODELS.name}]"), made)
    assert improvements(sweep, BEST_MODELS) == [True] * 6


def test_steps_are_whole_epochs_and_told_once() -> None:
    claims = step_claims()
    assert {claim.verdict for claim in claims} <= {"printed correctly", "printed wrong"}
    assert len({(claim.text.partition(",")[0], claim.printed) for claim in claims}) == len(claims)
