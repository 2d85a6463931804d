"""What things are made of: how the LiDAR and the camera see it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Material:
    """One material.

    Args:
        number: row of ``TABLE``.
        reflectance: 0..1, of a ray that meets it squarely.
        color: red, green, blue, 0..1.
        rough: metres, spread of what stands out from the surface in patches (bays, ledges, leaves).
        patch: metres, size of those patches.
        density: 1/metres, how soon a ray ends in it; 0 is solid, foliage has 1 to 4.
        gloss: 0..1, how much weaker its echo becomes away from the square (paint and metal against walls).
        loss: share of echoes that never come back.
        dark: share of echoes that come back without strength, whatever the distance.
    """

    number: int
    reflectance: float
    color: tuple[float, float, float]
    rough: float = 0.0
    patch: float = 0.5
    density: float = 0.0
    gloss: float = 0.0
    loss: float = 0.012
    dark: float = 0.1


ASPHALT = Material(0, 0.24, (0.36, 0.36, 0.37), 0.0)
PAVING = Material(1, 0.32, (0.55, 0.53, 0.5), 0.01)
GRASS = Material(2, 0.4, (0.33, 0.42, 0.2), 0.05, 0.25)
PAINT = Material(3, 0.3, (0.5, 0.5, 0.52), gloss=0.7, loss=0.03)
RUBBER = Material(4, 0.05, (0.07, 0.07, 0.08))
GLASS = Material(5, 0.1, (0.14, 0.17, 0.2), gloss=0.5, loss=0.55)
TRIM = Material(6, 0.15, (0.16, 0.16, 0.17), gloss=0.3)
CLOTH = Material(7, 0.3, (0.32, 0.3, 0.36), 0.02, 0.2)
SKIN = Material(8, 0.45, (0.75, 0.58, 0.48))
PLASTER = Material(9, 0.4, (0.74, 0.69, 0.6), 0.12, 1.3)
BRICK = Material(10, 0.3, (0.55, 0.38, 0.3), 0.15, 1.1)
STONE = Material(11, 0.35, (0.58, 0.55, 0.5), 0.05, 0.4)
WOOD = Material(12, 0.35, (0.4, 0.3, 0.2), 0.03, 0.3)
METAL = Material(13, 0.3, (0.5, 0.52, 0.54), gloss=0.5)
SIGN = Material(14, 0.95, (0.85, 0.85, 0.9))
LEAVES = Material(15, 0.34, (0.22, 0.36, 0.13), 0.0, density=2.2)
THICKET = Material(16, 0.34, (0.25, 0.36, 0.16), 0.0, density=5.0)
BARK = Material(17, 0.3, (0.33, 0.27, 0.21), 0.04, 0.2)
SOIL = Material(18, 0.3, (0.42, 0.36, 0.27), 0.06, 0.3)
# Of the points on KITTI's pedestrians 2 % have no strength within 20 m, 25 % beyond: as glossy as that takes.
FABRIC = Material(19, 0.4, (0.32, 0.3, 0.36), 0.02, 0.2, gloss=0.25, dark=0.01)

MATERIALS = (
    *(ASPHALT, PAVING, GRASS, PAINT, RUBBER, GLASS, TRIM, CLOTH, SKIN, PLASTER),
    *(BRICK, STONE, WOOD, METAL, SIGN, LEAVES, THICKET, BARK, SOIL, FABRIC),
)
ROUGH, PATCH, DENSITY, GLOSS, LOSS, DARK = range(6)  # columns of TABLE
TABLE = np.array([[m.rough, m.patch, m.density, m.gloss, m.loss, m.dark] for m in MATERIALS])
