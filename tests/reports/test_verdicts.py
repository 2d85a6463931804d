"""Verdicts as words and tables."""

import math

import numpy as np
import pytest

from fl3d.evaluation.verdicts import Verdict
from fl3d.reports.levels import Levels
from fl3d.reports.render import to_markdown
from fl3d.reports.verdicts import (
    ONE_SEED,
    findings,
    gain_text,
    in_short,
    seeds_text,
    verdict_tables,
    verdict_text,
    verdict_word,
)
from tests.reports.verdict_rows import verdict_rows

GAMMAS = Levels("gamma", ["0", "0.1", "0.5", "1", "2", "5"], "0")
NAN = math.nan


def row(verdict: Verdict, **changes: object) -> dict[str, object]:
    found: dict[str, object] = {"verdict": str(verdict), "seeds": 5, "more_seeds": NAN, "ap": 50.0}
    return found | {"gain": 2.0, "gain_low": -4.0, "gain_high": 4.0} | changes


@pytest.mark.parametrize(
    ("of", "text"),
    [
        (row(Verdict.BASELINE), "baseline"),
        (row(Verdict.BETTER), "better"),
        (row(Verdict.WORSE), "worse"),
        (row(Verdict.BETTER, gain_low=0.1, gain_high=0.4), "better, by less than 1 AP"),
        (row(Verdict.WORSE, gain_low=-0.4, gain_high=-0.1), "worse, by less than 1 AP"),
        (row(Verdict.EQUIVALENT), "equivalent within 1 AP"),
        (
            row(Verdict.EQUIVALENT, ap=100.0, gain=0.0, gain_low=0.0, gain_high=0.0),
            "equivalent within 1 AP: both find everything (AP 100)",
        ),
        (
            row(Verdict.EQUIVALENT, gain=0.0, gain_low=0.0, gain_high=0.0),
            "equivalent within 1 AP: the same AP in every resample, as if nothing read what it changes",
        ),
        (row(Verdict.UNDECIDED, more_seeds=4.0), "undecided, about 4 more seeds"),
        (row(Verdict.UNDECIDED, more_seeds=1.0), "undecided, about 1 more seed"),
        (
            row(Verdict.UNDECIDED, more_seeds=4.0, seed_minutes=6.3),
            "undecided, about 4 more seeds, 25 minutes of work",
        ),
        (
            row(Verdict.UNDECIDED, more_seeds=4.0, seed_minutes=60.0),
            "undecided, about 4 more seeds, 4 hours of work",
        ),
        (
            row(Verdict.UNDECIDED, more_seeds=2.0, seed_minutes=0.2),
            "undecided, about 2 more seeds, less than a minute of work",
        ),
        (row(Verdict.NONE, seeds=1), "frames only, not training"),
        (
            row(Verdict.NONE, seeds=1, copies="seeds 0, 1"),
            "none: seeds 0, 1 have the same detections: does the program read its seed?",
        ),
        (
            row(Verdict.NONE, seeds=2, more_seeds=3.0),
            "no verdict before 3 seeds, about 3 more seeds",
        ),
    ],
)
def test_words(of: dict[str, object], text: str) -> None:
    assert verdict_text(of, 1.0) == text  # type: ignore[arg-type]


def test_where_seeds_would_not_tell_that_is_said() -> None:
    text = verdict_text(row(Verdict.UNDECIDED), 1.0)  # type: ignore[arg-type]
    assert (
        text
        == "undecided; seeds alone would probably not tell, more frames or a wider margin might"
    )


def test_the_margin_is_told_as_it_was_given() -> None:
    assert verdict_text(row(Verdict.EQUIVALENT), 0.25) == "equivalent within 0.25 AP"  # type: ignore[arg-type]


def test_a_gain_has_its_sign_and_its_interval() -> None:
    of = row(Verdict.BETTER, gain=0.45, gain_low=-0.314, gain_high=1.2)
    assert gain_text(of) == "+0.45 [-0.31, +1.20]"  # type: ignore[arg-type]
    assert gain_text(of, 1) == "+0.5 [-0.3, +1.2]"  # type: ignore[arg-type]


def test_a_table_a_group_with_a_row_a_level_and_final_verdicts_in_bold() -> None:
    rows = verdict_rows(GAMMAS).iloc[::-1]
    tables = verdict_tables(rows, GAMMAS, 1.0, ("a note.",))
    assert [table.name for table in tables] == ["verdicts-3d-fcn", "verdicts-voxelnet"]
    for table in tables:
        assert [cell.text for cell in table.column("level")] == GAMMAS.labels
        assert [cell.text for cell in table.column("verdict")] == [
            "baseline",
            "better",
            "worse",
            "equivalent within 1 AP",
            "undecided, about 4 more seeds",
            "no verdict before 3 seeds; seeds alone would probably not tell, more frames or a wider margin might",
        ]
        assert [cell.bold for cell in table.column("verdict")] == [False, *[True] * 3, False, False]
        assert [cell.text for cell in table.column("gain")[:2]] == ["", "+2.00 [+0.30, +3.70]"]
        assert table.column("ap")[1].text == "72.00 [68.00, 72.00]"
        assert not any(cell.star for own in table.rows for cell in own)
    text = to_markdown(tables[1])
    assert "Verdicts on VoxelNet, 3d_r40/moderate, last models." in text
    assert "| γ | seeds | AP | gain over γ = 0 | verdict |" in text
    assert "equivalent: it lies within ± 1 AP" in text
    assert "hold all at once (95 %)" in text
    assert "a note." in text


def test_one_seed_claims_nothing() -> None:
    """No star, no bold, and the words that say what the interval is over."""
    rows = verdict_rows(GAMMAS, ("VoxelNet",), seeds=1)
    rows.loc[rows["verdict"] != "baseline", "verdict"] = str(Verdict.NONE)
    (table,) = verdict_tables(rows, GAMMAS, 1.0)
    assert {cell.text for cell in table.column("verdict")} == {"baseline", ONE_SEED}
    assert not any(cell.bold or cell.star for own in table.rows for cell in own)
    assert seeds_text(rows).startswith("Intervals over frames only, not training")


def test_where_a_level_lacks_seeds_of_the_baseline_its_gain_is_said_to_be_no_difference_of_aps() -> (
    None
):
    """Gamma 2 has three of five seeds, in one of two groups."""
    rows = verdict_rows(GAMMAS)
    assert [table.notes for table in verdict_tables(rows, GAMMAS, 1.0)] == [(), ()]
    rows.loc[(rows["group"] == "VoxelNet") & (rows["level"] == "2"), "seeds"] = 3
    plain, told = verdict_tables(rows, GAMMAS, 1.0, ("a note.",))
    assert plain.notes == ("a note.",)
    assert told.notes == (
        "a note.",
        "AP and gain of a level are of the seeds that it shares with the baseline, whose own AP is of all its seeds: "
        "the gain is not the difference of the two APs for γ = 2 (3 of 5).",
    )
    rows["copies"] = None
    rows.loc[rows["level"] == "2", "copies"] = "seeds 0, 1, 2"  # said where the seeds are counted
    assert [table.notes for table in verdict_tables(rows, GAMMAS, 1.0)] == [(), ()]


def test_in_short_names_levels_with_a_verdict_and_counts_the_others() -> None:
    text = in_short(verdict_rows(GAMMAS), GAMMAS)
    of_each = "γ = 0.1 better, γ = 0.5 worse, γ = 1 equivalent, 1 undecided, 1 without a verdict."
    assert text == f"3D-FCN: {of_each} VoxelNet: {of_each}"


def test_findings_name_what_is_decided_and_what_would_be_next() -> None:
    (told,) = findings(verdict_rows(GAMMAS, ("VoxelNet",)), GAMMAS, 1.0)
    base, *parts = told.removesuffix(".").split("; ")
    assert base == (
        "VoxelNet, against γ = 0, 3d_r40/moderate: γ = 0.1 is better (+2.0 [+0.3, +3.7] AP)"
    )
    assert parts[1:] == [
        "γ = 1 is equivalent within 1 AP (-0.1 [-0.8, +0.6] AP)",
        "1 undecided: γ = 2 (+0.5 [-2.0, +3.0] AP), about 4 more seeds",
        "1 without a verdict",
    ]


def test_findings_name_the_undecided_level_that_needs_the_fewest_seeds() -> None:
    rows = verdict_rows(GAMMAS, ("VoxelNet",))
    rows.loc[rows["level"] == "1", ["verdict", "more_seeds"]] = [str(Verdict.UNDECIDED), 9.0]
    (told,) = findings(rows, GAMMAS, 1.0)
    wanted = "2 undecided, of which γ = 2 (+0.5 [-2.0, +3.0] AP) needs the fewest seeds, about 4 more seeds"
    assert f"; {wanted}; " in told


def test_over_how_many_seeds_intervals_reach() -> None:
    rows = verdict_rows(GAMMAS)
    assert seeds_text(rows) == "Intervals over frames and 5 seeds of training."
    mixed = rows.assign(seeds=np.where(rows["level"] == "2", 3, rows["seeds"]))
    assert seeds_text(mixed) == "Intervals over frames and 3 / 5 seeds of training."


def test_a_group_of_which_only_the_baseline_is_done_is_told_so() -> None:
    both = verdict_rows(GAMMAS)
    alone = both[(both["level"] == "0") | (both["group"] == "VoxelNet")]
    assert in_short(alone, GAMMAS).startswith("3D-FCN: no other level is done. VoxelNet: ")
    assert findings(alone, GAMMAS, 1)[0] == (
        "3D-FCN, against γ = 0, 3d_r40/moderate: no other level is done."
    )


def test_copies_have_a_word_of_their_own_in_a_wide_table() -> None:
    assert verdict_word(row(Verdict.NONE, seeds=1, copies="seeds 0, 1")) == "copies"
    assert verdict_word(row(Verdict.NONE, seeds=1)) == "frames only"
