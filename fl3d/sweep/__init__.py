"""From trials to trained stages: plan, schedule, launch."""
