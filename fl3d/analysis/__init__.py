"""From finished sweeps to data frames: gains, recalls, other protocols, split halves, verification."""

MARGIN = 1.0  # AP: gains below it do not matter; as conf/config.yaml has it
