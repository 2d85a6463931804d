"""Hydra finds plugins under this name; the work is done in the package fl3d."""
