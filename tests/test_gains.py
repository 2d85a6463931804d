"""Gains over gamma = 0, with intervals."""

import pytest

from fl3d.errors import ConfigError
from fl3d.gains import gains, gains_to_markdown, recalls
from tests.evaluation.test_bootstrap import comparison, scene


def compared(noise: float) -> dict:
    """Gamma = 0 and a gamma = 2 whose boxes are that noisy, on the same frames."""
    return {
        ("VoxelNet", 0.0): {0: comparison(*scene(5, 60))},
        ("VoxelNet", 2.0): {0: comparison(*scene(5, 60, noise)), 1: comparison(*scene(5, 60, noise))},
    }


def test_a_clear_loss_is_starred_and_gamma_zero_gains_nothing() -> None:
    table = gains(compared(noise=0.5), n_resamples=100)
    assert len(table) == 2 * 3 * 3 * 2
    assert set(table["seeds"]) == {1}  # only those that gamma = 0 has as well
    zero = table[table["gamma"] == 0]
    assert (zero[["gain", "gain_low", "gain_high"]] == 0).all(axis=None)
    loss = table[(table["gamma"] == 2) & (table["metric"] == "3d") & (table["average"] == "R40")]
    assert (loss["gain"] < 0).all()
    assert loss["sure"].all()
    text = gains_to_markdown(table, "3d/moderate", "R40")
    assert text.count("| * |") == 1
    assert "| 0 |" in text


def test_a_sweep_without_gamma_zero_has_no_gain() -> None:
    alone = {key: value for key, value in compared(0.1).items() if key[1] > 0}
    with pytest.raises(ConfigError, match="needs a trial with gamma = 0"):
        gains(alone, 10)


def test_recall_is_given_for_every_trial_and_falls_with_the_overlap() -> None:
    table = recalls(compared(noise=0.2))
    assert table["gamma"].tolist() == [0, 2, 2]
    columns = [c for c in table if c.startswith("recall_")]
    assert columns == ["recall_0.1", "recall_0.3", "recall_0.5", "recall_0.7", "recall_0.9"]
    assert (table[columns].diff(axis=1).iloc[:, 1:] <= 0).all(axis=None)
