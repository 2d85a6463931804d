"""A street simulator: scenes of convex shapes, ray-cast by an HDL-64E-like LiDAR, labelled by KITTI's rules."""

VERSION = 2  # raised whenever the same settings and seed give other bytes
MOST_PEOPLE = 3.0  # times as often as in KITTI: nearly every frame has people then
