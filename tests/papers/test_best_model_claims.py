"""Sentences of the paper about its best models: counted, and not judged by the frames that chose them."""

from fl3d.papers.focal_loss.best_model_claims import CHOSEN, best_claim, step_claims
from fl3d.papers.focal_loss.published_cells import published_table
from fl3d.papers.focal_loss.tables import BEST_MODELS, best_pairs
from fl3d.reports.table import AP_COLUMNS
from tests.papers.making import Made, aps, finished_sweep


def test_not_all_metrics_of_the_best_models_improve() -> None:
    printed = published_table("IV").rename(columns=AP_COLUMNS)
    claim = best_claim(printed)
    assert (claim.recomputed, claim.ours) == ("11 of 12", "11 of 12")
    assert claim.verdict == f"false by one cell (VoxelNet 3D hard, 0.01); {CHOSEN}"


def test_best_models_of_ours_get_no_verdict_though_all_improve() -> None:
    made = [
        Made(overrides=(f"loss.gamma={gamma}", f"seed={seed}"), scores={1: aps(10 + 20 * gamma)})
        for gamma in (0, 1)
        for seed in range(3)
    ]
    sweep = finished_sweep(("detector=voxelnet", f"sweep.tables=[{BEST_MODELS.name}]"), made)
    claim = best_claim(best_pairs(sweep))
    assert claim.ours == "6 of 6"
    assert claim.verdict.endswith(f"; {CHOSEN}")


def test_without_best_models_nothing_is_said_of_ours() -> None:
    claim = best_claim(published_table("IV").iloc[:0])
    assert (claim.ours, claim.verdict) == ("", "false by one cell (VoxelNet 3D hard, 0.01)")


def test_steps_are_whole_epochs_and_told_once() -> None:
    claims = step_claims()
    assert {claim.verdict for claim in claims} <= {"printed correctly", "printed wrong"}
    assert len({(claim.text.partition(",")[0], claim.printed) for claim in claims}) == len(claims)
