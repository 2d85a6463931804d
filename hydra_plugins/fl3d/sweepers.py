"""`hydra/sweeper=grid`, `optuna` and `until_decided`: doorways from Hydra to fl3d's planner.

Hydra runs this file at every start: what is heavy is imported where it is used.
"""

from abc import abstractmethod
from typing import Any

from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf


class Doorway(Sweeper):
    """Hands a multirun to ``fl3d.api.training``; the sweepers behind it know nothing of Hydra's classes.

    Attributes:
        counts_seeds: whether a word such as ``seed=5`` says where it begins, and picks no trials of the sweep.
        searches: whether it picks among the values, where others train all of them.
    """

    counts_seeds = False
    searches = False

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Keep what Hydra gives; the task function is not called, stages are."""
        self.loader = hydra_context.config_loader
        self.composed = config

    def sweep(self, arguments: list[str]) -> None:
        """Run the sweep to its tables."""
        from fl3d.api.training import train_sweep
        from fl3d.config.compose import multirun_of

        train_sweep(multirun_of(self.loader, self.composed, arguments), self)

    @abstractmethod
    def proposer(self, arguments: list[str], compose: Any) -> Any:
        """The ``fl3d.sweep.sweepers.base.Sweeper`` behind this door."""


class GridSweeper(Doorway):
    """Every combination of swept values.

    Args:
        params: swept values by key, in Hydra's grammar.
    """

    def __init__(self, params: dict[str, Any]) -> None:
        self.params = params

    def proposer(self, arguments: list[str], compose: Any) -> Any:
        """The grid."""
        from fl3d.sweep.sweepers.grid import grid

        return grid(self.params, arguments, compose)


class UntilDecidedSweeper(Doorway):
    """Seeds in rounds, see ``fl3d.sweep.sweepers.rounds.Rounds`` for the arguments."""

    counts_seeds = True

    def __init__(self, params: dict[str, Any], **settings: Any) -> None:
        self.params = params
        self.settings = settings

    def proposer(self, arguments: list[str], compose: Any) -> Any:
        """The grid, in rounds."""
        from fl3d.sweep.sweepers.until_decided import until_decided

        return until_decided(self.params, arguments, compose, self.settings)


class OptunaSweeper(Doorway):
    """Trials by an Optuna study, see ``fl3d.sweep.sweepers.study.Study`` for the arguments."""

    searches = True

    def __init__(self, params: dict[str, Any], **settings: Any) -> None:
        self.params = params
        self.settings = settings

    def proposer(self, arguments: list[str], compose: Any) -> Any:
        """The study."""
        from fl3d.sweep.sweepers.study import study

        return study(_plain(self.params), arguments, compose, _plain(self.settings))


def _plain(section: Any) -> Any:
    return OmegaConf.to_container(OmegaConf.create(section), resolve=True)
