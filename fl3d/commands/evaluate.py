"""``evaluate``: KITTI's official numbers of anybody's result files."""

from __future__ import annotations

import json
from pathlib import Path

from fl3d.commands.words import parser
from fl3d.config.compose import CONF, compose_config
from fl3d.config.settings import read_settings
from fl3d.core.errors import ConfigError
from fl3d.core.files import write_text
from fl3d.evaluation.average_precision import Curves, as_json
from fl3d.evaluation.folders import curves_to_markdown, evaluate_folder


def run(arguments: list[str]) -> None:
    """Evaluate a folder of KITTI result files (NNNNNN.txt), whoever wrote them.

    The rules are KITTI's official ones. The frames evaluated are those that have a result file; the
    results are taken as they are.
    """
    protocols = sorted(path.stem for path in (CONF / "protocol").glob("*.yaml"))
    options = parser("evaluate", run.__doc__)
    options.add_argument(
        "labels",
        type=Path,
        metavar="LABELS",
        help="folder of label files, such as training/label_2",
    )
    options.add_argument(
        "results",
        type=Path,
        metavar="RESULTS",
        help="folder of result files, one a frame",
    )
    options.add_argument(
        "--protocol",
        default="kitti",
        choices=protocols,
        help="overlaps and variant (default: kitti)",
    )
    options.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        help="thresholds, counts, precisions and AP in full",
    )
    given = options.parse_args(arguments)
    config = compose_config([f"protocol={given.protocol}", "profile=paper"])
    protocol = read_settings(config).protocol
    curves, n_frames = evaluate_folder(given.labels, given.results, protocol)
    rules = f"protocol {protocol.name} (variant {protocol.variant})"
    print(f"{n_frames} frames, {rules}; AP in percent\n")
    print(curves_to_markdown(curves))
    if given.json:
        _write_json(given.json, curves)


def _write_json(path: Path, curves: Curves) -> None:
    try:
        write_text(path, json.dumps(as_json(curves)) + "\n")
    except OSError as error:
        raise ConfigError(f"--json {path}: cannot be written ({error.strerror})") from None
