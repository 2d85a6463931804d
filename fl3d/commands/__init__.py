"""What can be typed behind ``python -m fl3d``: a file for each command, called as it is typed."""
