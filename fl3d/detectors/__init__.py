"""Detectors: one file each, over shared blocks; found by the `_target_` of their YAML."""
