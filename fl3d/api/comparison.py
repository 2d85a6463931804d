"""Anybody's detectors against each other, by their result files."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from fl3d.analysis import MARGIN
from fl3d.analysis.compare import Compared, compare_detectors
from fl3d.analysis.compare_page import write_comparison
from fl3d.analysis.detectors import Detector
from fl3d.analysis.result_folders import MISSING, hold
from fl3d.analysis.surroundings import Surroundings
from fl3d.config.protocols import read_protocol
from fl3d.core.errors import ConfigError, ResultsWarning
from fl3d.evaluation.protocol import Protocol

Folders = Path | str | Sequence[Path | str]


def compare(
    labels: Path | str,
    detectors: Mapping[str, Folders] | Sequence[Detector],
    *,
    baseline: str | None = None,
    classes: Sequence[str] = (),
    protocol: str | Protocol = "kitti",
    overlaps: Mapping[str, tuple[float, float, float]] | None = None,
    split: Path | str | None = None,
    missing: str = MISSING[0],
    mapping: Path | str | None = None,
    margin: float = MARGIN,
    out: Path | str | None = None,
    clouds: Path | str | None = None,
    calib: Path | str | None = None,
    pictures: Path | str | None = None,
    made_by: str = "fl3d.compare",
    warn: Callable[[str], object] | None = None,
) -> Compared:
    """Say whether a detector is better than another, whatever code trained them: ``fl3d compare``.

    Args:
        labels: folder of label files.
        detectors: folders of result files by the detector's name, one for each run of its training; three runs of
            each bring a verdict.
        baseline: name of the detector that the others are held against; None: the first.
        classes: that are compared; none: those that two of the detectors detect.
        protocol: a name, or a protocol.
        overlaps: of classes of your own, for image, bird's-eye view and 3D: ``{"Cone": (0.5, 0.25, 0.25)}``.
        split: file of the frames to compare on, one a line; None: all.
        missing: a frame that a folder has no file of: ``error``, ``skip`` or ``empty``.
        mapping: folder of KITTI's mapping of frames to drives; None: ``mapping`` beside ``training``, if there.
        margin: gains below it do not matter, AP.
        out: folder that a page, tables and figures are written to; None: nothing is written.
        clouds: folder ``velodyne``, for the page.
        calib: of the clouds; None: ``calib`` beside ``labels``.
        pictures: folder ``image_2``, for the page.
        made_by: how the page says that it was made.
        warn: is told what looks like a mistake in labels or results, a line at a time; None: it is warned of, as
            ``ResultsWarning``.

    Returns:
        the data frames ``cells`` (APs and gains with intervals) and ``verdicts``, and notes.

    Raises:
        ConfigError: names, classes or a protocol that do not fit, or ``clouds`` and ``pictures`` without ``out``.
        DataError: a folder or a file that cannot be used, or folders of other frames.
    """
    chosen = protocol if isinstance(protocol, Protocol) else read_protocol(protocol)
    chosen = replace(chosen, overlaps={**chosen.overlaps, **(overlaps or {})})
    if out is None and (clouds or pictures):
        raise ConfigError("clouds and pictures are for the page: name a folder for it with out")
    beside = calib or Path(labels).resolve().parent / "calib"
    surroundings = Surroundings(_path(clouds), _path(beside), _path(pictures))
    held = hold(
        Path(labels),
        _detectors(detectors),
        chosen,
        split=_path(split),
        missing=missing,
        mapping=_path(mapping),
    )
    surroundings.check(held.ids)
    for line in held.warnings:
        if warn is None:
            warnings.warn(line, ResultsWarning, stacklevel=2)
        else:
            warn(line)
    compared = compare_detectors(held, baseline, classes, margin)
    if out is not None:
        try:
            write_comparison(compared, Path(out), surroundings, made_by)
        except OSError as error:
            raise ConfigError(f"--out {out}: cannot be written ({error.strerror})") from None
    return compared


def _detectors(given: Mapping[str, Folders] | Sequence[Detector]) -> Sequence[Detector]:
    if not isinstance(given, Mapping):
        return given
    return [
        Detector(name, (Path(own),) if isinstance(own, Path | str) else tuple(map(Path, own)))
        for name, own in given.items()
    ]


def _path(given: Path | str | None) -> Path | None:
    return None if given is None else Path(given)
