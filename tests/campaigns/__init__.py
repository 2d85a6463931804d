"""Campaigns: fl3d under kills, malformed input, a bad disk, clocks that disagree and many starts at once.

    python -m tests.campaigns.kills --seed 0 --count 200

Each module is one campaign, and says what it tried and what it found; docs/robust.md has the figures.
"""
