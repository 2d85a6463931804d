"""``import``: result folders of anybody's checkpoints as trials of a sweep."""

from __future__ import annotations

import argparse
import inspect
from pathlib import Path

from fl3d.commands.parsing import HELP, parser
from fl3d.core.errors import ConfigError
from fl3d.core.loading import loading
from fl3d.core.plurals import several

EXAMPLES = """\
  import 'exp/gamma{level}/seed{seed}/epoch_{epoch}/data' --factor gamma sweep.name=pv data=kitti data.root=/data/kitti
  import list.csv --factor lr sweep.name=pv ...             columns: level,seed,epoch,folder (and detector)

{level} is the value that is compared, {seed} that of the training (0 where it is missing), {epoch} the checkpoint's,
{detector} its name; * is any text. A folder holds NNNNNN.txt of every validation frame. Afterwards:
  gains detector=imported sweep.name=pv data=kitti data.root=/data/kitti
"""


def run(arguments: list[str]) -> None:
    """Take result folders of checkpoints that were trained elsewhere into a sweep.

    Their scores go to MLflow, tables, figures, gains and verdicts, as if fl3d had trained them. What
    was imported before is not imported again.
    """
    options = parser("import", inspect.cleandoc(run.__doc__ or ""))
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.epilog = EXAMPLES
    options.add_argument(
        "source", metavar="PATTERN|FILE.csv", help="the folders, or a list of them"
    )
    options.add_argument("overrides", nargs="*", help=HELP)
    options.add_argument(
        "--factor", default="level", help="what is compared, such as gamma (default: level)"
    )
    options.add_argument(
        "--name", default="Imported", help="the detector's name in tables (default: Imported)"
    )
    given = options.parse_intermixed_args(arguments)
    if any(word.startswith("detector=") for word in given.overrides):
        raise ConfigError("import: detector=... is not needed; --name says what tables call it")
    with loading():
        from fl3d.api.training import report
        from fl3d.config.compose import compose_config
        from fl3d.config.settings import BY_HAND, read_settings
        from fl3d.runs.by_hand_names import sweep_name
        from fl3d.sweep.imported import Import, find_results, keep, read_list
        from fl3d.sweep.launchers.inline import InlineLauncher
        from fl3d.sweep.prepare import prepare_data
        from fl3d.sweep.run import run_sweep
        from fl3d.sweep.setup import prepare_sweep
        from fl3d.sweep.sweepers.grid import Listed

    is_list = given.source.endswith(".csv")
    results = read_list(Path(given.source)) if is_list else find_results(given.source)
    words = ["detector=imported", *given.overrides]
    base = compose_config(words)
    if (
        base["sweep"]["name"] == BY_HAND
    ):  # of another place, or of another factor, it is another sweep
        words.append(f"sweep.name={sweep_name(words, {given.factor: given.source})}")
        base = compose_config(words)
    ids = prepare_data(read_settings(base).data).val_ids
    points = Import(results, base, given.factor, given.name, ids).points()
    prepared = prepare_sweep(Listed(points), words)
    added = keep(prepared, prepared.plan, print)
    counts = f"{several(len(results), 'checkpoint')} of {several(len(points), 'trial')}"
    print(f"{counts}; {several(added, 'trial')} {'is' if added == 1 else 'are'} new")
    ran = run_sweep(prepared, InlineLauncher())
    report(prepared, ran, words, print)
    ran.outcome.check()
    print(f"Its words: {' '.join(words)}")
