"""What a store folder holds of stages and sweeps, and the only parsers of it."""
