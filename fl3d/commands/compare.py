"""``compare``: anybody's detectors, by their result files."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path

from fl3d.analysis.compare import MARGIN, compare_detectors
from fl3d.analysis.result_folders import MISSING, hold, read_detectors
from fl3d.commands.words import parser
from fl3d.config.compose import CONF, compose_config
from fl3d.config.settings import read_settings
from fl3d.core.errors import ConfigError
from fl3d.data.splits import read_split
from fl3d.evaluation.protocol import Protocol
from fl3d.reports.comparison import gain_table, shown_of, verdict_table
from fl3d.reports.render import to_text

DESCRIPTION = """\
Say whether a detector is better than another, by KITTI result files (one NNNNNN.txt a frame) that any code wrote.

It prints the AP of each by KITTI's official rules, its gain over the baseline with intervals that hold for all gains
at once, and, from three runs of training on, a verdict: better, worse, equivalent within a margin, or undecided and
about how many more runs would tell. One run of each says nothing about another training: no verdict.
"""
EXAMPLES = """\
examples:
  python -m fl3d compare training/label_2 theirs=results/theirs mine=results/mine
  python -m fl3d compare training/label_2 theirs=t0,t1,t2 mine=m0,m1,m2 --classes Car --out comparison

The second compares three runs of each, which is what a verdict needs, and writes tables for a paper and a page:
comparison/compare.html. Frames of one drive are much alike: where the folder `mapping` of KITTI's development kit lies
beside `training`, or --mapping names it, drives are resampled instead of frames.
"""


def run(arguments: list[str]) -> None:
    """Compare detectors by folders of KITTI result files, whoever wrote them."""
