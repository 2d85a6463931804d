"""Solids that rays can hit: extruded outlines and ellipsoids, as rows of numbers, and their planes.

A thing is a few parts in its own frame (u ahead, v to the left, w up from its bottom centre, metres). Placing it turns
the parts and shears them with the ground below, so that a long wall follows a slope.
"""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from fl3d.simulator.materials import Material

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Parts = Float  # (K, COLUMNS)

MAX_POINTS = 8  # of an outline
MAX_PLANES = MAX_POINTS + 2
ELLIPSOID, EXTRUSION = 0.0, 1.0
FLAT = 0.85  # of a normal's z, above which a face is a roof or a floor: openings are in the sides
# Columns of a part: what it is, where it stands in the thing, half its width below and above, and its outline.
KIND, U, V, W, YAW, HALF_LOW, HALF_HIGH, N_POINTS, OUTLINE = 0, 1, 2, 3, 4, 5, 6, 7, 8
MATERIAL = OUTLINE + 2 * MAX_POINTS
REFLECTANCE, PASS, RED = MATERIAL + 1, MATERIAL + 2, MATERIAL + 3
COLUMNS = RED + 3
Color = tuple[float, float, float]


def extrusion(
    outline: Sequence[tuple[float, float]],
    half_width: float | tuple[float, float],
    material: Material,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    reflectance: float | None = None,
    color: Color | None = None,
    opening: float = 0.0,
) -> Float:
    """A convex outline in the (u, w) plane, drawn out sideways: one part.

    Args:
        outline: (u, w) corners, counter-clockwise seen from the right (u to the right, w up); at most 8.
        half_width: to either side; two values lean the sides from the outline's lowest to its highest corner.
        material: what it is made of.
        at: u, v, w of its origin in the thing.
        yaw: of the part in the thing.
        reflectance: instead of the material's.
        color: instead of the material's, 0..1.
        opening: share of rays that pass the sides (windows, rails); what is inside or behind is hit instead.
    """
    low, high = half_width if isinstance(half_width, tuple) else (half_width, half_width)
    row = np.zeros(COLUMNS)
    row[:OUTLINE] = EXTRUSION, *at, yaw, low, high, len(outline)
    row[OUTLINE : OUTLINE + 2 * len(outline)] = [value for corner in outline for value in corner]
    return _made_of(row, material, reflectance, color, opening)


def box(
    size: tuple[float, float, float],
    material: Material,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
    reflectance: float | None = None,
    color: Color | None = None,
    opening: float = 0.0,
) -> Float:
    """An upright box of length, width and height; ``at`` is its bottom centre."""
    half, height = size[0] / 2, size[2]
    outline = ((-half, 0.0), (half, 0.0), (half, height), (-half, height))
    return extrusion(outline, size[1] / 2, material, at, yaw, reflectance, color, opening)


def ellipsoid(
    radii: tuple[float, float, float],
    material: Material,
    at: tuple[float, float, float],
    reflectance: float | None = None,
    color: Color | None = None,
) -> Float:
    """An ellipsoid about ``at``."""
    row = np.zeros(COLUMNS)
    row[:OUTLINE] = ELLIPSOID, *at, 0.0, radii[1], radii[1], 0
    row[OUTLINE : OUTLINE + 3] = radii
    return _made_of(row, material, reflectance, color, 0.0)


def _made_of(
    row: Float, material: Material, reflectance: float | None, color: Color | None, opening: float
) -> Float:
    row[MATERIAL], row[PASS] = material.number, opening
    row[REFLECTANCE] = material.reflectance if reflectance is None else reflectance
    row[RED:] = material.color if color is None else color
    return row


class Solids:
    """The solids of a scene, ready for rays.

    Args:
        parts: (S, COLUMNS).
        placements: (S, 6) of each part's thing: x, y, z of its bottom centre, heading, and the ground's slopes along
            x and y there.
        owners: (S,) the labelled object it belongs to, or -1.

    Attributes:
        planes: (S, MAX_PLANES, 4) rows n, d of half-spaces n.x <= d, unused rows zero; of an ellipsoid, centre,
            radii, and (cos, sin) of its heading.
        counts: (S,) planes in use; 0 for an ellipsoid.
        corners: (S, 2 MAX_POINTS, 3); those of the box around an ellipsoid; the last one repeated.
        nearest: (S,) a lower bound of the horizontal distance from the LiDAR.
    """

    def __init__(self, parts: Parts, placements: Float, owners: NDArray[np.int64]) -> None:
        self.planes, self.counts, self.corners, self.nearest = _build(parts, placements)
        order = np.argsort(self.nearest, kind="stable")  # near ones first: they hide the others
        self.parts, self.owners = np.ascontiguousarray(parts[order]), owners[order]
        self.planes, self.counts = self.planes[order], self.counts[order]
        self.corners, self.nearest = self.corners[order], self.nearest[order]

    def __len__(self) -> int:
        return len(self.owners)


@numba.njit(cache=True, error_model="numpy")
def _build(parts: Float, placements: Float) -> tuple[Float, NDArray[np.int64], Float, Float]:
    n = parts.shape[0]
    planes = np.zeros((n, MAX_PLANES, 4))
    counts = np.zeros(n, dtype=np.int64)
    corners = np.zeros((n, 2 * MAX_POINTS, 3))
    nearest = np.zeros(n)
    local = np.zeros(3)
    for s in range(n):
        part, place = parts[s], placements[s]
        c, sn = np.cos(place[3]), np.sin(place[3])
        along, across = (
            place[4] * c + place[5] * sn,
            place[5] * c - place[4] * sn,
        )  # slopes along u and v
        pc, ps = np.cos(part[YAW]), np.sin(part[YAW])
        cos, sin = c * pc - sn * ps, sn * pc + c * ps
        slope_u, slope_v = along * pc + across * ps, across * pc - along * ps
        x = place[0] + part[U] * c - part[V] * sn
        y = place[1] + part[U] * sn + part[V] * c
        z = place[2] + part[W] + along * part[U] + across * part[V]
        if part[KIND] == ELLIPSOID:
            planes[s, 0, :3] = x, y, z
            planes[s, 1, :3] = part[OUTLINE], part[OUTLINE + 1], part[OUTLINE + 2]
            planes[s, 2, :2] = cos, sin
            half_u = part[OUTLINE]
            for k in range(2 * MAX_POINTS):
                local[0] = half_u if k & 1 else -half_u
                local[1] = part[OUTLINE + 1] if k & 2 else -part[OUTLINE + 1]
                local[2] = part[OUTLINE + 2] if k & 4 else -part[OUTLINE + 2]
                corners[s, k, 0] = x + cos * local[0] - sin * local[1]
                corners[s, k, 1] = y + sin * local[0] + cos * local[1]
                corners[s, k, 2] = z + local[2]
            nearest[s] = max(0.0, np.hypot(x, y) - max(half_u, part[OUTLINE + 1]))
            continue
        m = int(part[N_POINTS])
        low = high = part[OUTLINE + 1]
        u_low = u_high = part[OUTLINE]
        for k in range(m):
            low, high = min(low, part[OUTLINE + 2 * k + 1]), max(high, part[OUTLINE + 2 * k + 1])
            u_low, u_high = min(u_low, part[OUTLINE + 2 * k]), max(u_high, part[OUTLINE + 2 * k])
        lean = (part[HALF_HIGH] - part[HALF_LOW]) / (high - low)
        counts[s] = m + 2
        for k in range(m + 2):
            if k < m:
                u0, w0 = part[OUTLINE + 2 * k], part[OUTLINE + 2 * k + 1]
                following = (k + 1) % m
                u1, w1 = part[OUTLINE + 2 * following], part[OUTLINE + 2 * following + 1]
                nu, nv, nw = w1 - w0, 0.0, u0 - u1
                d = nu * u0 + nw * w0
            else:
                nu, nv, nw = 0.0, 1.0 if k == m else -1.0, -lean
                d = part[HALF_LOW] - lean * low
            # w = z' - slope_u u - slope_v v: the shear moves into the normal
            nu, nv = nu - nw * slope_u, nv - nw * slope_v
            nx, ny = nu * cos - nv * sin, nu * sin + nv * cos
            length = np.sqrt(nx * nx + ny * ny + nw * nw)
            planes[s, k, 0], planes[s, k, 1], planes[s, k, 2] = (
                nx / length,
                ny / length,
                nw / length,
            )
            planes[s, k, 3] = (d + nx * x + ny * y + nw * z) / length
        for k in range(2 * MAX_POINTS):
            point = min(k // 2, m - 1)
            u, w = part[OUTLINE + 2 * point], part[OUTLINE + 2 * point + 1]
            v = (part[HALF_LOW] + lean * (w - low)) * (1.0 if k & 1 else -1.0)
            corners[s, k, 0] = x + cos * u - sin * v
            corners[s, k, 1] = y + sin * u + cos * v
            corners[s, k, 2] = z + w + slope_u * u + slope_v * v
        widest = max(part[HALF_LOW], part[HALF_HIGH])
        own_u, own_v = -x * cos - y * sin, x * sin - y * cos  # the LiDAR, seen from the part
        du = max(u_low - own_u, 0.0, own_u - u_high)
        dv = max(-widest - own_v, 0.0, own_v - widest)
        nearest[s] = np.hypot(du, dv)
    return planes, counts, corners, nearest


@numba.njit(cache=True, error_model="numpy", inline="always")
def enter_solid(planes: Float, count: int, o: Float, d: Float) -> tuple[float, float, int]:
    """Where the ray o + t d enters and leaves a solid, and through which plane; entering after leaving is a miss."""
    if count == 0:
        cos, sin = planes[2, 0], planes[2, 1]
        px, py, pz = o[0] - planes[0, 0], o[1] - planes[0, 1], o[2] - planes[0, 2]
        u0, v0, w0 = (
            (px * cos + py * sin) / planes[1, 0],
            (py * cos - px * sin) / planes[1, 1],
            pz / planes[1, 2],
        )
        u1, v1 = (d[0] * cos + d[1] * sin) / planes[1, 0], (d[1] * cos - d[0] * sin) / planes[1, 1]
        w1 = d[2] / planes[1, 2]
        a, b, c = (
            u1 * u1 + v1 * v1 + w1 * w1,
            u0 * u1 + v0 * v1 + w0 * w1,
            u0 * u0 + v0 * v0 + w0 * w0 - 1,
        )
        root = b * b - a * c
        if root <= 0:
            return 1.0, 0.0, 0
        root = np.sqrt(root)
        return (-b - root) / a, (-b + root) / a, 0
    enter, leave, through = -1e9, 1e9, 0
    for k in range(count):
        slope = planes[k, 0] * d[0] + planes[k, 1] * d[1] + planes[k, 2] * d[2]
        gap = planes[k, 3] - (planes[k, 0] * o[0] + planes[k, 1] * o[1] + planes[k, 2] * o[2])
        if slope == 0.0:
            if gap < 0:
                return 1.0, 0.0, 0
        elif slope < 0:
            if gap / slope > enter:
                enter, through = gap / slope, k
        else:
            leave = min(leave, gap / slope)
        if enter > leave:
            return 1.0, 0.0, 0
    return enter, leave, through


@numba.njit(cache=True, error_model="numpy")
def normal_at(planes: Float, count: int, through: int, point: Float) -> tuple[float, float, float]:
    """Outward normal of a solid where a ray entered it."""
    if count > 0:
        return planes[through, 0], planes[through, 1], planes[through, 2]
    cos, sin = planes[2, 0], planes[2, 1]
    px, py, pz = point[0] - planes[0, 0], point[1] - planes[0, 1], point[2] - planes[0, 2]
    u, v, w = (
        (px * cos + py * sin) / planes[1, 0] ** 2,
        (py * cos - px * sin) / planes[1, 1] ** 2,
        pz / planes[1, 2] ** 2,
    )
    length = np.sqrt(u * u + v * v + w * w)
    return (u * cos - v * sin) / length, (u * sin + v * cos) / length, w / length


@numba.njit(cache=True, error_model="numpy", inline="always")
def hit_ground(ground: Float, o: Float, d: Float) -> float:
    """Where a ray meets z = g0 + g1 x + g2 y + g3 (x^2 + y^2); 1e9 where it does not."""
    a = ground[3] * (d[0] * d[0] + d[1] * d[1])
    b = ground[1] * d[0] + ground[2] * d[1] + 2 * ground[3] * (o[0] * d[0] + o[1] * d[1]) - d[2]
    c = (
        ground[0]
        + ground[1] * o[0]
        + ground[2] * o[1]
        + ground[3] * (o[0] * o[0] + o[1] * o[1])
        - o[2]
    )
    root = b * b - 4 * a * c
    if root < 0:
        return 1e9
    below = b + np.sqrt(root)
    return -2 * c / below if below > 0 else 1e9
