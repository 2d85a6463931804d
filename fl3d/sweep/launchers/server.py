"""Loaded by the fork server alone: it ends at once when the sweep has, without taking down all that it has loaded.

Else it holds the sweep's output open for seconds, and whoever reads that (``| tee log``) waits.
"""

from __future__ import annotations

import atexit
import os

_SERVER = os.getpid()


def _leave() -> None:
    if os.getpid() == _SERVER:
        os._exit(0)


atexit.register(_leave)
