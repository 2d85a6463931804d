"""A trial of a finished sweep: what it is, and where its checkpoints lie."""

from __future__ import annotations

from dataclasses import dataclass

from fl3d.core.errors import StoreError
from fl3d.runs.layout import RunFolder
from fl3d.runs.plans import FrozenTrial
from fl3d.runs.spec import end_of


@dataclass(frozen=True)
class FinishedTrial:
    """A trial that is trained to its end.

    Args:
        plan: what it is.
        folders: of its stages, first to last; none where its scores come from a results folder.
    """

    plan: FrozenTrial
    folders: tuple[RunFolder, ...]

    @property
    def key(self) -> str:
        """Its identity: the key of its last stage."""
        return self.plan.key

    @property
    def group(self) -> str:
        """Label of what it shares with the trials that it is compared with."""
        return self.plan.group

    @property
    def level(self) -> str:
        """Label of its value of the factor."""
        return self.plan.level

    @property
    def seed(self) -> int:
        """Of its training."""
        return self.plan.seed

    @property
    def detector(self) -> str:
        """As the papers write it."""
        return self.plan.detector

    @property
    def folder(self) -> RunFolder:
        """Run folder of its last stage.

        Raises:
            StoreError: its scores come from a results folder, which has no run folders.
        """
        if not self.folders:
            raise StoreError(
                f"{self.key}: only its scores are here; run the sweep to have its checkpoints"
            )
        return self.folders[-1]

    @property
    def last_step(self) -> int:
        """Step of its last checkpoint."""
        return self.folder.steps()[-1]

    @property
    def steps(self) -> set[int]:
        """Steps of all checkpoints of its stages, and the one that it has ended with, listed or not."""
        found = {step for folder in self.folders for step in folder.steps()}
        end = end_of(self.folder)
        return found if end is None else found | {end}

    def holder(self, step: int) -> RunFolder:
        """Run folder of the stage that holds a checkpoint.

        Raises:
            StoreError: none does.
        """
        for folder in reversed(self.folders or (self.folder,)):
            if step in folder.steps():
                return folder
        raise StoreError(
            f"{self.key}: neither it nor a stage it resumes from has a checkpoint at step {step}"
        )
