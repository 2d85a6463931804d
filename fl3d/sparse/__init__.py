"""Convolutions over maps that are mostly background: the dense ones' function, at the work of what differs."""
