"""fl3d: find out whether a loss or a hyper-parameter really makes a 3D object detector better.

From Python, by the functions behind the commands of the same names (docs/python.md):

    fl3d.evaluate(labels, results)            KITTI's official numbers of anybody's result files
    fl3d.compare(labels, {name: folders})     whether a detector is better than another
    fl3d.simulate(out, frames)                a KITTI folder of the simulator's
    fl3d.check(folder)                        a folder looked through before anything is trained
    fl3d.run("+sweep=gamma", "seeds=3")       a sweep trained to its verdicts
    fl3d.open_sweep("+sweep=gamma")           what a sweep has found: data frames and figures
    fl3d.load_detector(checkpoint)            a trained detector, for points that Python holds

Importing fl3d loads none of them and changes nothing: no thread settings, no backend of matplotlib's.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fl3d.api.comparison import compare
    from fl3d.api.detectors import load_detector
    from fl3d.api.evaluation import evaluate
    from fl3d.api.inspection import check
    from fl3d.api.simulation import simulate
    from fl3d.api.sweeps import open_sweep, run
    from fl3d.core.errors import Fl3dError, ResultsWarning

__version__ = "0.1.0"
__all__ = [
    "Fl3dError",
    "ResultsWarning",
    "__version__",
    "check",
    "compare",
    "evaluate",
    "load_detector",
    "open_sweep",
    "run",
    "simulate",
]

_MODULES = {
    "Fl3dError": "fl3d.core.errors",
    "ResultsWarning": "fl3d.core.errors",
    "check": "fl3d.api.inspection",
    "compare": "fl3d.api.comparison",
    "evaluate": "fl3d.api.evaluation",
    "load_detector": "fl3d.api.detectors",
    "open_sweep": "fl3d.api.sweeps",
    "run": "fl3d.api.sweeps",
    "simulate": "fl3d.api.simulation",
}


def __getattr__(name: str) -> Any:
    """Load what is asked for (PEP 562).

    Raises:
        AttributeError: there is no such name.
        NotInstalled: it needs an extra that is not installed.
    """
    if name not in _MODULES:
        raise AttributeError(f"module 'fl3d' has no attribute '{name}'")
    try:
        found = getattr(import_module(_MODULES[name]), name)
    except ModuleNotFoundError as error:
        from fl3d.core.errors import NotInstalled
        from fl3d.core.extras import lacking

        why = lacking(error)
        if why is None:
            raise
        raise NotInstalled(f"fl3d.{name} {why}") from error
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """What it offers, and what it has loaded."""
    return sorted({*globals(), *__all__})
