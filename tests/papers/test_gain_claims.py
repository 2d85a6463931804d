"""Sentences of the paper that state a number: what its own cells say of them."""

import pandas as pd

from fl3d.papers.focal_loss.gain_claims import (
    best_claim,
    claims_table,
    gain_claims,
    published_last,
    step_claims,
)
from fl3d.papers.focal_loss.published_cells import published_table
from fl3d.reports.table import AP_COLUMNS


def test_the_papers_own_cells_give_its_claims() -> None:
    ours = {detector: published_last(detector) for detector in ("3D-FCN", "VoxelNet")}
    found = {(claim.text, claim.printed): claim for claim in gain_claims(ours)}
    largest = found["largest gain of 3D-FCN for 0 < γ ≤ 2", "11.2"]
    assert (largest.recomputed, largest.ours) == ("11.21", "11.21")
    assert largest.verdict == "printed correctly; higher in ours too"
    assert found["smallest gain of 3D-FCN for 0 < γ ≤ 2", "0.3"].recomputed == "0.38"
    assert found["largest loss of VoxelNet for γ = 0.2, 2", "2.7"].recomputed == "2.71"
    assert found["largest loss of VoxelNet for γ = 5", ""].recomputed == "7.21"


def test_a_store_without_a_detector_has_no_number_for_it() -> None:
    assert {claim.ours for claim in gain_claims({})} == {""}
    only = pd.DataFrame({column: [1.0] for column in AP_COLUMNS}, index=[2.0])  # no gamma = 0
    assert {claim.ours for claim in gain_claims({"VoxelNet": only})} == {""}


def test_a_claim_of_some_of_its_gammas_says_of_which() -> None:
    only = pd.DataFrame({column: [1.0, 3.0] for column in AP_COLUMNS}, index=[0.0, 0.5])
    claims = [claim for claim in gain_claims({"VoxelNet": only}) if claim.ours]
    assert {claim.ours for claim in claims} == {"2.00"}
    assert all(claim.text.endswith("(ours: γ = 0.5)") for claim in claims)


def test_not_all_metrics_of_the_best_models_improve() -> None:
    printed = published_table("IV").rename(columns=AP_COLUMNS)
    claim = best_claim(printed)
    assert (claim.recomputed, claim.ours) == ("11 of 12", "11 of 12")


def test_what_nothing_is_known_of_is_a_dash() -> None:
    table = claims_table(step_claims())
    assert {cell.text for cell in table.column("ours")} == {"–"}
    assert {cell.text for cell in table.column("verdict")} <= {"printed correctly", "printed wrong"}
