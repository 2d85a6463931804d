"""Puts into a wheel what lies beside the package in a checkout; `fl3d.core.shipped` finds either."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Shipped(BuildHookInterface):  # type: ignore[type-arg]
    """Maps conf/ and sweeps/ to fl3d/conf, and published scores to fl3d/results."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Name the files; an editable install needs none, for it runs in the checkout.

        Args:
            version: of the build, "editable" or "standard".
            build_data: of hatchling, changed in place.
        """
        if version == "editable":
            return
        root = Path(self.root)
        files = {path: path.relative_to(root) for path in root.glob("conf/**/*.yaml")}
        files |= {path: Path("conf/sweep", path.name) for path in root.glob("sweeps/*.yaml")}
        files |= {path: path.relative_to(root) for path in root.glob("results/*/scores/*")}
        build_data["force_include"] |= {str(path): f"fl3d/{to}" for path, to in files.items()}
