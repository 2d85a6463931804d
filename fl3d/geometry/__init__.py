"""Boxes, overlaps and non-maximum suppression."""
