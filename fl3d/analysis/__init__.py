"""From finished sweeps to data frames: gains, recalls, other protocols, split halves, verification."""
