"""What Python code and the commands call alike; ``import fl3d`` offers it, see ``fl3d.__init__``."""
