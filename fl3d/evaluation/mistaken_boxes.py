"""Other readings of the boxes of results, by which they fit their labels where they do not as they are. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from fl3d.geometry.boxes import fold

Float = NDArray[np.float64]
Order = tuple[int, ...]
AS_IS: Order = (0, 1, 2)
Y, H, RY = 1, 3, 6  # columns of boxes_cam
SIZES = ("height", "width", "length")
AXES = ("x", "y", "z")
UNITS = {3: "millimetres", 2: "centimetres", -3: "kilometres"}
# Half of the pairs differ in none of height, width and length by more than this logarithm: 0.04 to 0.09 of honest
# results; 0.35 of a pedestrian's width and length swapped, 0.9 of a car's. (A car's height and width are too alike to
# be told apart: 0.11.)
SIZES_OFF = 0.25
# Metres; half of the pairs are further apart: 0.14 to 0.45 m of honest results, and 2.9 m at least with an axis turned
# or two swapped.
PLACES_OFF = 1.0
# Another reading must be so many times nearer. Honest results are nearest as they are, but for sizes of cyclists, who
# are as high as long: 1.3 times nearer with both swapped. The next best reading of places is 6 times farther at least.
TIMES_BETTER = 3.0
# Of half a height: how far y may be from a mistake's, and half of the pairs from each other. Honest y are off by 0.04
# at most, and differ by 0.06.
HEIGHTS_LIKE, HEIGHTS_APART = 0.25, 0.3
# Radians, of those pairs that two readings tell apart: honest ones are off by 0.02 to 0.65, and by 0.5 at least when
# they are read otherwise.
HEADINGS_OFF, HEADINGS_FIT, TOLD_APART = 0.4, 0.15, 0.5
FEWEST_TURNED = 10  # pairs that two readings tell apart
# Overlap in the picture of results that fit from above: 0.65 to 0.93 of honest ones.
PICTURE_OFF, PICTURE_FITS, PICTURE_ELSEWHERE = 0.3, 0.6, 0.1


def in_space(name: str, labels: Float, results: Float) -> Iterator[tuple[str, str]]:
    """Kind and text of what is odd about 3D boxes: units, sizes, places, headings.

    Args:
        name: of the class.
        labels: (K, 7) boxes_cam.
        results: (K, 7) of the same objects.
    """
    own = _upright(labels, results)
    size_power, place_power = _size_power(labels, own), _place_power(labels, own)
    yield from _units(name, size_power, place_power)
    own[:, 3:6] /= 10.0**size_power
    own[:, :3] /= 10.0**place_power
    yield from _sizes(name, labels, own)
    yield from _places(name, labels, own)
    yield from _headings(name, labels, own)


def of_medians(name: str, labels: Float, results: Float) -> Iterator[tuple[str, str]]:
    """What can be told without pairs, by medians of a class: units, and the order of sizes."""
    label, result = (np.median(boxes, axis=0)[None] for boxes in (labels, results))
    power = _size_power(label, result)
    away = [
        max(float(np.median(np.linalg.norm(boxes[:, :3], axis=1))), 1e-9)
        for boxes in (labels, results)
    ]
    yield from _units(name, power, _power(float(np.log10(away[1] / away[0]))))
    result[:, 3:6] /= 10.0**power
    yield from _sizes(name, label, result)


def in_picture(name: str, labels: Float, results: Float) -> Iterator[tuple[str, str]]:
    """Kind and text of what is odd about 2D boxes.

    Args:
        name: of the class.
        labels: (K, 4) boxes_image.
        results: (K, 4) of the same objects, as they are written.
    """
    as_is = float(np.median(_shared(results, labels)))
    if as_is >= PICTURE_OFF:
        return
    read = {text: boxes for text, boxes in _picture_readings(labels, results)}
    fits = {text: float(np.median(_shared(boxes, labels))) for text, boxes in read.items()}
    best = max(fits, key=lambda text: fits[text])
    told = (
        f"2D boxes of {len(labels)} results of {name} overlap their labels' by {as_is:.2f} (median)"
    )
    if fits[best] >= PICTURE_FITS:
        yield (
            "picture",
            f"{told}, and by {fits[best]:.2f} when read as {best}; KITTI's are x1 y1 x2 y2",
        )
    elif as_is < PICTURE_ELSEWHERE:
        yield (
            "picture",
            f"{told}, though the boxes fit from above: were they projected with another P2?",
        )


def _picture_readings(labels: Float, results: Float) -> Iterator[tuple[str, Float]]:
    """What four numbers may be, and the x1 y1 x2 y2 that they then are."""
    orders = {"x2 y1 x1 y2": (2, 1, 0, 3), "x1 y2 x2 y1": (0, 3, 2, 1), "x2 y2 x1 y1": (2, 3, 0, 1)}
    orders |= {"y1 x1 y2 x2": (1, 0, 3, 2), "x1 x2 y1 y2": (0, 2, 1, 3)}
    for text, order in orders.items():
        yield text, results[:, list(order)]
    corner, size = results[:, :2], results[:, 2:]
    yield "x y w h, x y the upper left corner", np.hstack([corner, corner + size])
    yield "x y w h, x y the middle", np.hstack([corner - size / 2, corner + size / 2])
    sums = results[:, :2] + results[:, 2:], labels[:, :2] + labels[:, 2:]
    scale = np.median(sums[0] / np.maximum(sums[1], 1e-9), axis=0)
    if (scale > 0).all():
        text = f"of pictures scaled by {scale[0]:.4g} x {scale[1]:.4g}"
        yield text, results / np.tile(scale, 2)


def _shared(a: Float, b: Float) -> Float:
    """(K,) overlap of each box with the one in the same row; 0 of a reversed one."""
    size = np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2])
    shared = np.clip(size, 0, None).prod(axis=1)
    areas = [np.clip(box[:, 2:] - box[:, :2], 0, None).prod(axis=1) for box in (a, b)]
    return np.asarray(shared / np.maximum(areas[0] + areas[1] - shared, 1e-9))


def _upright(labels: Float, results: Float) -> Float:
    """The results as KITTI writes them where width and length are swapped and the heading is turned: the same boxes."""
    turned = results[:, [0, 1, 2, 3, 5, 4, 6]] + np.array([0, 0, 0, 0, 0, 0, np.pi / 2])
    is_same = _misfit(labels, turned, AS_IS) < _misfit(labels, results, AS_IS)
    is_same &= _off(turned[:, RY], labels) < _off(results[:, RY], labels)
    return turned if is_same else results.copy()


def _power(log: float) -> int:
    """The power of ten that a factor is, of the units that people use; 0: none."""
    power = round(log)
    return power if power in UNITS and abs(log - power) < 0.3 else 0


def _size_power(labels: Float, results: Float) -> int:
    logs = np.log10(results[:, 3:6]) - np.log10(labels[:, 3:6])
    return _power(float(np.median(logs.mean(axis=1))))  # whatever their order


def _place_power(labels: Float, results: Float) -> int:
    away = [np.maximum(np.linalg.norm(boxes[:, :3], axis=1), 1e-9) for boxes in (labels, results)]
    return _power(float(np.median(np.log10(away[1] / away[0]))))


def _units(name: str, sizes: int, places: int) -> Iterator[tuple[str, str]]:
    told: dict[int, list[str]] = {}
    for what, power in (("sizes", sizes), ("places", places)):
        told.setdefault(power, []).append(what)
    told.pop(0, None)
    for power, whats in told.items():
        yield (
            "units",
            f"{' and '.join(whats)} of {name} are {10.0**power:g} times those of their labels ({UNITS[power]}?); "
            "KITTI's are metres",
        )


def _misfit(labels: Float, results: Float, order: Order) -> float:
    """Median over the pairs of the largest logarithm by which a height, width or length differs."""
    read = results[:, [H + column for column in order]]
    return float(np.median(np.abs(np.log(read / labels[:, 3:6])).max(axis=1)))


def _sizes(name: str, labels: Float, results: Float) -> Iterator[tuple[str, str]]:
    found = {order: _misfit(labels, results, order) for order in permutations(AS_IS)}
    best = min(found, key=lambda order: found[order])
    if found[AS_IS] < SIZES_OFF or found[best] * TIMES_BETTER > found[AS_IS]:
        return
    written = [SIZES[best.index(column)] for column in AS_IS]
    yield (
        "sizes",
        f"sizes of {name} seem to be written as {', '.join(written)}: medians are {_three(results[:, 3:6])} m of "
        f"results, {_three(labels[:, 3:6])} m of labels; KITTI's order is height, width, length",
    )


def _three(values: Float) -> str:
    return ", ".join(f"{value:.2f}" for value in np.median(values, axis=0))


def _places(name: str, labels: Float, results: Float) -> Iterator[tuple[str, str]]:
    """Axes that are swapped or turned; else y that is not the bottom's; else all of them shifted alike."""
    apart = {
        (order, signs): _apart(labels[:, :3], results[:, list(order)] * signs)
        for order in permutations(AS_IS)
        for signs in product((1, -1), repeat=3)
    }
    as_is = apart[AS_IS, (1, 1, 1)]
    order, signs = min(apart, key=lambda reading: apart[reading])
    best = apart[order, signs]
    if as_is > PLACES_OFF and best * TIMES_BETTER < as_is:
        written = ["-" * (signs[axis] < 0) + AXES[axis] for axis in (order.index(c) for c in AS_IS)]
        lidar = " (the LiDAR's axes?)" if written == ["z", "-x", "-y"] else ""
        yield (
            "places",
            f"places of {name} seem to be written as {', '.join(written)}{lidar}: half of {len(labels)} results are "
            f"{as_is:.3g} m or more from their labels, and {best:.2g} m when so read; KITTI's are x right, y down, "
            "z forward",
        )
        return
    heights = list(_heights(name, labels, results))
    yield from heights or _shifts(name, labels, results, as_is)


def _apart(labels: Float, results: Float) -> float:
    return float(np.median(np.linalg.norm(results - labels, axis=1)))


def _heights(name: str, labels: Float, results: Float) -> Iterator[tuple[str, str]]:
    """The bottom's y, off by half a height up or down."""
    off = (results[:, Y] - labels[:, Y]) / (labels[:, H] / 2)
    middle = float(np.median(off))
    if np.median(np.abs(off - middle)) > HEIGHTS_APART:
        return
    for halves, where in ((-1, "the middle"), (1, "half a height below the bottom")):
        if abs(middle - halves) < HEIGHTS_LIKE:
            metres = float(np.median(results[:, Y] - labels[:, Y]))
            side = "above" if metres < 0 else "below"
            yield (
                "heights",
                f"y of {name} seems to be {where} of the box: {len(labels)} results stand {abs(metres):.2f} m {side} "
                f"their labels (median; half their height is {np.median(labels[:, H]) / 2:.2f} m); KITTI's y is the "
                "bottom",
            )


def _shifts(name: str, labels: Float, results: Float, as_is: float) -> Iterator[tuple[str, str]]:
    """All off alike: the origin is not the camera."""
    shift = np.median(results[:, :3] - labels[:, :3], axis=0)
    left = _apart(labels[:, :3], results[:, :3] - shift)
    if as_is > PLACES_OFF and left * TIMES_BETTER < as_is:
        told = ", ".join(f"{value:+.2f}" for value in shift)
        yield (
            "places",
            f"{len(labels)} results of {name} stand off their labels by {told} m in x, y, z, and by {left:.2g} m "
            "without that shift (medians); KITTI's origin is the camera",
        )


def _off(headings: Float, labels: Float) -> float:
    return float(np.median(_between(headings, labels[:, RY])))


def _between(a: Float, b: Float) -> Float:
    """Angles between headings modulo half a turn, which leaves a box as it is."""
    return np.abs(fold(a - b, -np.pi / 2))


def _headings(name: str, labels: Float, results: Float) -> Iterator[tuple[str, str]]:
    """Another sense or origin of the angle."""
    ry = results[:, RY]
    readings = {
        "a LiDAR's yaw, which is -rotation_y - pi/2": -ry - np.pi / 2,
        "turned the other way, -rotation_y": -ry,
        "turned by a quarter, rotation_y + pi/2": ry + np.pi / 2,
    }
    told = []
    for text, read in readings.items():
        apart = _between(read, ry) > TOLD_APART
        if apart.sum() < FEWEST_TURNED:
            continue
        as_is, best = _off(ry[apart], labels[apart]), _off(read[apart], labels[apart])
        if as_is > HEADINGS_OFF and best < HEADINGS_FIT:
            mean = float(_between(read, labels[:, RY]).mean())
            told.append((mean, text, int(apart.sum()), as_is, best))
    if told:
        _, text, n, as_is, best = min(told)
        yield (
            "headings",
            f"rotation_y of {name} seems to be {text}: of {n} results half are off by {as_is:.2f} rad or more, and by "
            f"{best:.2f} when so read; KITTI's is 0 along x, and -pi/2 along z",
        )
