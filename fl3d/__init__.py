"""fl3d: find out whether a loss or a hyper-parameter really makes a 3D object detector better."""

__version__ = "0.1.0"
