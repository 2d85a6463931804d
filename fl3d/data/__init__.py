"""KITTI folders: read, write, simulate, and turn into training samples."""
