"""Tables of the paper with intervals are about the paper's baseline, whichever level a sweep is held against."""

from collections.abc import Mapping

import numpy as np
import pytest

from fl3d.analysis.contributions import Contributions
from fl3d.analysis.found import judge_sweep
from fl3d.analysis.samples import Resampled, Samples
from fl3d.papers.base import PaperTable
from fl3d.papers.focal_loss.best_models import BEST_MODELS
from fl3d.papers.focal_loss.tables import LAST_3D_FCN, LOSS_FORMS
from fl3d.papers.views import interval_views
from fl3d.reports.table import Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.units import Units
from tests.papers.making import Made, aps, finished_sweep

SEEDS = (0, 1, 2)
OF_GAMMA = ("loss.gamma=0", 51.0), ("loss.gamma=1", 56.0), ("loss.gamma=2", 61.0)


class Sure(Contributions):
    """Of models whose AP is the same in every resample."""

    units = Units("frames", np.arange(4), "a note")  # type: ignore[assignment]

    def samples(self, rule: str = "last") -> Samples:
        found: dict[str, dict[str, dict[int, Resampled]]] = {}
        chosen = self.sweep.select(rule)
        for row in chosen.to_dict("records"):
            ap = row["ap_3d/moderate"]
            levels = found.setdefault(row["group"], {}).setdefault(row["level"], {})
            levels[row["seed"]] = Resampled(np.full((9, 2), ap), np.full((50, 9, 2), ap))
        return found


def swept(trials: Mapping[str, float], *words: str) -> FinishedSweep:
    """3D-FCN, three seeds of each, a point apart."""
    made = [
        Made(overrides=(*overrides.split(), f"seed={seed}"), scores={1: aps(ap + seed - 1)})
        for overrides, ap in trials.items()
        for seed in SEEDS
    ]
    return finished_sweep(("detector=fcn3d", *words), made)


def view_of(paper_table: PaperTable, sweep: FinishedSweep) -> Table:
    made = Sure(sweep)
    table = paper_table.make([sweep], ())
    assert table is not None
    (view,) = interval_views(sweep, [table], judge_sweep(sweep, contributions=made), made)
    return view


def marks(view: Table) -> dict[str, tuple[bool, bool, str]]:
    """Of each row whether 3D hard is bold and has a star, and the verdict."""
    cells = zip(view.rows, view.column("3d_hard"), view.column("verdict"), strict=True)
    return {row[0].text: (ap.bold, ap.star, word.text) for row, ap, word in cells}


@pytest.mark.parametrize("words", [(), ("sweep.baseline=2",)])
@pytest.mark.parametrize("turned", [False, True])
def test_table_ii_is_held_against_gamma_zero_whichever_baseline_the_sweep_has(
    words: tuple[str, ...], turned: bool
) -> None:
    """APs of 51, 56 and 61 for gamma 0, 1 and 2, in this order and the other, in which gamma 2 is the first level."""
    trials = dict(reversed(OF_GAMMA) if turned else OF_GAMMA)
    sweep = swept(trials, "+sweep=gamma", *words)
    is_other = turned or bool(words)
    assert sweep.baseline == ("2" if is_other else "0")
    view = view_of(LAST_3D_FCN, sweep)
    assert "bold: better than γ = 0" in view.legend
    assert marks(view) == {
        "0": (False, False, "baseline"),
        "1": (True, True, "better"),
        "2": (True, True, "better"),
    }
    note = "Held against γ = 0, as in the paper; the sweep's own verdicts are against γ = 2."
    assert (view.notes[-1] == note) == is_other


def test_without_gamma_zero_table_ii_says_what_it_is_held_against() -> None:
    view = view_of(LAST_3D_FCN, swept(dict(OF_GAMMA[1:]), "+sweep=gamma"))
    assert "bold: better than γ = 1" in view.legend
    assert marks(view) == {"1": (False, False, "baseline"), "2": (True, True, "better")}
    assert not any(note.startswith("Held against") for note in view.notes)


@pytest.mark.parametrize("key", ["loss", "loss.normalize"])
def test_table_v_is_held_against_the_original_loss_whichever_was_run_first(key: str) -> None:
    """By hand: 44 against 40, a difference of 4 in each seed."""
    enhanced, original = ("enhanced", "original") if key == "loss" else ("true", "false")
    sweep = swept({f"{key}={enhanced}": 44.0, f"{key}={original}": 40.0}, "+sweep=loss_form")
    assert sweep.baseline == enhanced
    view = view_of(LOSS_FORMS, sweep)
    assert "bold: better than the original" in view.legend
    assert marks(view) == {
        "Original": (False, False, "baseline"),
        "Enhanced": (True, True, "better"),
    }


def test_aps_of_the_best_models_are_of_the_seeds_that_gamma_zero_has() -> None:
    """Gamma 1, the sweep's baseline, has seed 0 alone: of 51 with seeds 50, 51 and 52 that would be 50."""
    made = [
        Made(overrides=(f"loss.gamma={gamma}", f"seed={seed}"), scores={1: aps(ap + seed - 1)})
        for gamma, ap, seeds in ((1, 41.0, (0,)), (0, 51.0, SEEDS), (2, 61.0, SEEDS))
        for seed in seeds
    ]
    view = view_of(BEST_MODELS, finished_sweep(("detector=fcn3d", "+sweep=gamma"), made))
    assert [cell.text.partition(" ")[0] for cell in view.column("3d_hard")] == ["51.00", "61.00"]
