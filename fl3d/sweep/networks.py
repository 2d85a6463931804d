"""Networks of a sweep's configs, built before anything is trained so that what cannot be built is refused now."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from fl3d.config.objects import build
from fl3d.core.digests import digest
from fl3d.core.records import Config
from fl3d.detectors.base import Detector
from fl3d.inference.load import build_detector
from fl3d.training.build import build_augmentation, build_optimizer


class Networks:
    """Builds what configs name, on no device, and each thing once: a sweep of 10,000 trials may differ in one number.

    A loss looks at its own values; a network is built with the first loss of a class, for it must not depend on the
    values of its loss, see ``detectors.base.Detector``.
    """

    def __init__(self) -> None:
        self._networks: dict[str, Detector] = {}
        self._seen: set[str] = set()

    def network(self, config: Config) -> Detector:
        """The network of a trial's or a stage's config; not to be changed.

        Raises:
            ConfigError: its ``detector`` or its ``loss`` cannot be built.
        """
        loss = config.get("loss") or {}
        key = digest(
            [config["detector"], config.get("classes"), loss.get("_target_"), sorted(loss)]
        )
        if key not in self._networks:
            with torch.device("meta"):
                self._networks[key] = build_detector(config)
        self._once("loss", loss, lambda: build(loss, "loss"))
        return self._networks[key]

    def check_training(self, config: Config) -> None:
        """Build what trains a network: its optimiser and its augmentation.

        Raises:
            ConfigError: one of them cannot be built.
        """
        network = self.network(config)
        sections = [config["detector"], config.get("classes"), config.get("optimizer")]
        with torch.device("meta"):
            self._once("optimizer", sections, lambda: build_optimizer(config, network))
        self._once("augment", config["augment"], lambda: build_augmentation(config))

    def check_compiled(self, config: Config) -> None:
        """Set a stage's network up to be compiled; it would be when it runs.

        Raises:
            ConfigError: it cannot be.
        """
        with torch.device("meta"):
            self._once(
                "compile", config["detector"], lambda: build_detector(config).compile_dense()
            )

    def _once(self, kind: str, content: Any, check: Callable[[], object]) -> None:
        """Make a check unless the same content has passed it before."""
        key = digest([kind, content])
        if key not in self._seen:
            check()
            self._seen.add(key)
