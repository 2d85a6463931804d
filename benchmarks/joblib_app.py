"""A trial as a plain Hydra job, its stages one after another: what `scheduler.py` holds against fl3d's own way."""

from __future__ import annotations

import warnings
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

from fl3d.config import CONF, resolve
from fl3d.pipeline import Sweep
from fl3d.records import StagePaths
from fl3d.sweep.sweepers.base import Point
from fl3d.sweep.sweepers.grid import Listed
from fl3d.training.run import run_stage, write_spec

warnings.filterwarnings("ignore", message=".*hydra.*", category=DeprecationWarning)


@hydra.main(config_path=str(CONF), config_name="config", version_base="1.3")
def main(config: DictConfig) -> None:
    work = Path(config.work)
    OmegaConf.set_struct(config, False)
    del config["work"]
    name = f"{config.detector._target_.rsplit('.', 1)[-1]}-{config.loss.gamma}"
    config.store.root = str(work / name)
    sweep = Sweep(Listed([Point((), resolve(config))]))
    for key, stage in sweep.plan.stages.items():
        paths = StagePaths(sweep.stages_root / key)
        write_spec(paths, stage, sweep.machine())
        run_stage(paths.folder)


if __name__ == "__main__":
    main()
