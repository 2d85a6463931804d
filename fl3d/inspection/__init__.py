"""A KITTI-format folder looked through before anything is trained: what is there, what counts, what is odd."""

VERSION = 3  # raised when what is found, or how it is said, changes: stored checks are made again
MOST_CLOUDS = 200  # of each split that are looked at, unless told otherwise
