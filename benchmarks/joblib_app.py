"""A trial as a plain Hydra job, its stages in turn: what `scheduler.py` compares fl3d with."""

from __future__ import annotations

import warnings
from pathlib import Path

import hydra
from omegaconf import DictConfig, OmegaConf

from fl3d.config.compose import CONF, resolve
from fl3d.runs.spec import Spec, write_spec
from fl3d.sweep.setup import machine, prepare_sweep
from fl3d.sweep.sweepers.grid import Listed, point_of
from fl3d.training.stage import run_stage

warnings.filterwarnings("ignore", message=".*hydra.*", category=DeprecationWarning)


@hydra.main(config_path=str(CONF), config_name="config", version_base="1.3")
def main(config: DictConfig) -> None:
    work = Path(config.work)
    OmegaConf.set_struct(config, False)
    del config["work"]
    name = f"{config.detector._target_.rsplit('.', 1)[-1]}-{config.loss.gamma}"
    config.store.root = str(work / name)
    prepared = prepare_sweep(Listed([point_of([], resolve(config))]))
    for key, stage in prepared.plan.stages.items():
        folder = prepared.layout.run(key)
        write_spec(folder, Spec(stage, machine(prepared)))
        run_stage(folder.path)


if __name__ == "__main__":
    main()
