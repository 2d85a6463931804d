"""From finished sweeps to data frames: gains, recalls, other protocols, split halves, verification."""

AVERAGES = ("R11", "R40")  # of precisions at 11 recalls, and at 40
MARGIN = 1.0  # AP: gains below it do not matter; as conf/config.yaml has it
