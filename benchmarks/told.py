"""How a benchmark ends: one line of JSON with its name, the machine's facts and what it found."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from fl3d.core.provenance import provenance


def tell(name: str, found: Mapping[str, Any]) -> None:
    """Print the last line of a benchmark.

    Args:
        name: of its script, without ending.
        found: plain values, ratios first of all; floats are kept to four digits.
    """
    facts = provenance()
    line = {
        "benchmark": name,
        "machine": facts["fl3d.machine"].partition(": ")[2],  # the host's name is nobody's business
        "packages": facts["fl3d.packages"],
        "commit": facts.get("fl3d.commit", "unknown"),
        "found": _rounded(found),
    }
    print(json.dumps(line), flush=True)


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value
