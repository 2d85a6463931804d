"""`hydra/sweeper=grid`: a doorway from Hydra to fl3d's planner."""

from typing import Any

from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf


class GridSweeper(Sweeper):
    """Composes each trial of a grid and hands all of them to ``fl3d.pipeline`` as one plan.

    Args:
        params: swept values by key, in Hydra's grammar.
    """

    def __init__(self, params: dict[str, Any]) -> None:
        self.params = params

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """Keep what Hydra gives; the task function is not called, stages are."""
        self.loader, self.composed = hydra_context.config_loader, config

    def sweep(self, arguments: list[str]) -> None:
        """Compose every trial, then run them."""
        from fl3d.config import resolve
        from fl3d.pipeline import run_trials
        from fl3d.sweep.sweepers.grid import expand

        fixed, grid = expand(self.params, arguments)
        trials = [(swept, resolve(self.loader.load_sweep_config(self.composed, [*fixed, *swept]))) for swept in grid]
        launcher: Any = OmegaConf.to_container(self.composed.hydra.launcher, resolve=True)
        run_trials(trials, launcher)
