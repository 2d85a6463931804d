"""The command line: Hydra's for training and sweeps, and a few commands beside it."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

# One thread a process: two processes of one thread beat one of two. Before numpy and torch are loaded.
for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from fl3d.config import CONF, MAIN, check_overrides, compose_config  # noqa: E402
from fl3d.errors import ConfigError, Fl3dError, options  # noqa: E402

if TYPE_CHECKING:
    from fl3d.store.tracking import Store

# Hydra's own options that are followed by a value.
HYDRA_VALUES = ("--cfg", "-c", "--package", "-p", "--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; anything that is not the name of one goes to Hydra."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        if given and given[0] in COMMANDS:
            COMMANDS[given[0]](given[1:])
        else:
            train(given)
    except Fl3dError as error:
        sys.exit(f"fl3d: {error}")
    except KeyboardInterrupt:
        sys.exit("\nfl3d: interrupted; run the same command to go on")


def train(arguments: list[str]) -> None:
    """Train one trial, or with -m a sweep."""
    import hydra
    from hydra.errors import HydraException
    from omegaconf import DictConfig

    check_overrides(_overrides(arguments))
    warnings.filterwarnings("ignore", message=".*hydra.*", category=DeprecationWarning)

    ended: list[BaseException] = []

    @hydra.main(config_path=str(CONF), config_name=MAIN, version_base="1.3")
    def task(config: DictConfig) -> None:
        from hydra.core.hydra_config import HydraConfig

        from fl3d.config import resolve, section
        from fl3d.pipeline import run_sweep
        from fl3d.sweep.sweepers.base import Point
        from fl3d.sweep.sweepers.grid import Listed

        hydra = HydraConfig.get()
        if config.sweep.name != "trials":
            ended.append(ConfigError(f"a sweep file is run with -m: python -m fl3d -m +sweep={config.sweep.name}"))
            return
        point = Point(tuple(hydra.overrides.task), resolve(config))
        try:
            run_sweep(Listed([point]), section(hydra, "launcher"))
        except (Fl3dError, KeyboardInterrupt) as error:
            ended.append(error)  # past Hydra, which would print a message of its own

    # Hydra would print an error and a hint of its own; with the full error on, ours comes through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    sys.argv = ["python -m fl3d", *arguments]
    try:
        task()
    except HydraException as error:
        raise ConfigError(str(error).strip()) from None
    if ended:
        raise ended[0]


def _overrides(arguments: list[str]) -> list[str]:
    """The overrides among Hydra's arguments.

    Raises:
        ConfigError: an argument that is neither an option, nor KEY=VALUE, nor a command.
    """
    found: list[str] = []
    rest = iter(arguments)
    for argument in rest:
        if argument in HYDRA_VALUES:
            next(rest, None)
        elif not argument.startswith("-"):
            if "=" not in argument and not argument.startswith("~"):
                raise ConfigError(f"'{argument}' is neither KEY=VALUE nor a command. {options(argument, COMMANDS)}")
            found.append(argument)
    return found


def plan(arguments: list[str]) -> None:
    """Show what a sweep would do: stages and what they share, what is done, time, FLOPs and disk. Trains nothing."""
    parser = _parser("plan", plan.__doc__)
    parser.add_argument("overrides", nargs="*", help="as for -m, such as +sweep=gamma profile=paper data=kitti")
    overrides = parser.parse_intermixed_args(arguments).overrides
    from fl3d.config import multirun
    from fl3d.preview import preview
    from fl3d.sweep.winners import with_winners

    preview(with_winners(multirun(overrides or ["+sweep=gamma"])))


def tables(arguments: list[str]) -> None:
    """Make tables again, beside the published ones and with intervals, without training anything.

    Without +sweep=NAME: of every sweep that was run on the data and profile.
    """
    parser = _parser("tables", tables.__doc__)
    parser.add_argument(
        "overrides", nargs="*", help="as for training, such as +sweep=gamma profile=quick data=kitti_sample"
    )
    overrides = parser.parse_intermixed_args(arguments).overrides
    from fl3d.paper.tables import write_all_tables

    write_all_tables(overrides)


def figures(arguments: list[str]) -> None:
    """Draw the figures of a sweep over gamma, without training anything; those of windows run its last and best models.

    What the models say of the validation frames' windows is kept in the store, so a second time is quick.
    """
    parser = _parser("figures", figures.__doc__)
    parser.add_argument("overrides", nargs="*", help="as for training, such as profile=quick data=kitti_sample")
    overrides = parser.parse_intermixed_args(arguments).overrides
    from fl3d.paper.figures import write_figures

    write_figures(overrides)


def report(arguments: list[str]) -> None:
    """Make tables, figures, claims and one page of them (report.html) of a sweep over gamma; trains nothing."""
    parser = _parser("report", report.__doc__)
    parser.add_argument("overrides", nargs="*", help="as for training, such as profile=quick data=kitti_sample")
    overrides = parser.parse_intermixed_args(arguments).overrides
    from fl3d.paper.page import write_page

    write_page(overrides)


def rescore(arguments: list[str]) -> None:
    """Score a sweep's stored detections again under other protocol values; no network is run.

    Values with commas are compared: score_threshold=0,0.5,0.8,0.9 or nms_iou=0.1,0.5 nms_kind=standup,rotated,3d.
    """
    parser = _parser("rescore", rescore.__doc__)
    parser.add_argument("overrides", nargs="+", help="+sweep=NAME data=... profile=..., and KEY=VALUES of the protocol")
    parser.add_argument("--metric", default="3d/moderate", help="of the printed table (default: 3d/moderate, R11)")
    options = parser.parse_intermixed_args(arguments)
    from fl3d.rescore import KEYS, rescore_and_write
    from fl3d.sweep.sweepers.grid import values_of

    changes, rest = {}, []
    for override in options.overrides:
        key = override.partition("=")[0].removeprefix("protocol.")
        if key in KEYS:
            changes[key] = values_of(override)
        else:
            rest.append(override)
    if not changes:
        raise ConfigError(f"nothing to compare; give KEY=VALUE,VALUE with one of: {', '.join(KEYS)}")
    rescore_and_write(compose_config(rest), changes, options.metric)


def gains(arguments: list[str]) -> None:
    """Say how sure a sweep's gains over gamma = 0 are: intervals over frames and seeds, from stored detections."""
    parser = _parser("gains", gains.__doc__)
    parser.add_argument("overrides", nargs="+", help="as for training, such as +sweep=gamma data=... profile=...")
    parser.add_argument("--metric", default="3d/moderate", help="of the printed table (default: 3d/moderate)")
    parser.add_argument("--average", default="R40", choices=("R11", "R40"), help="of the printed table (default: R40)")
    options = parser.parse_intermixed_args(arguments)
    from fl3d.gains import gains_and_write

    gains_and_write(compose_config(options.overrides), options.metric, options.average)


def why(arguments: list[str]) -> None:
    """Print the chain from a table's cell to its run, checkpoint, files and digests.

    TABLE is II, III or IV; gamma=, detector= and seed= pick the row, other KEY=VALUE choose the sweep, as for tables.
    Example: python -m fl3d why II gamma=2 3d/moderate data=simulated profile=quick
    """
    parser = _parser("why", why.__doc__)
    parser.add_argument("table", metavar="TABLE")
    parser.add_argument("rest", nargs="+", metavar="KEY=VALUE|METRIC", help="row, metric and sweep, in any order")
    given = parser.parse_intermixed_args(arguments)
    from fl3d.evidence import why as trace

    metrics = [one for one in given.rest if "=" not in one]
    if len(metrics) != 1:
        raise ConfigError(f"why: give one metric, such as 3d/moderate, not {' '.join(metrics) or 'none'}")
    pairs = [one for one in given.rest if "=" in one]
    row = {
        key: value for key, _, value in (one.partition("=") for one in pairs) if key in ("gamma", "detector", "seed")
    }
    overrides = [one for one in pairs if one.partition("=")[0] not in row]
    if not any(one.startswith("+sweep=") for one in overrides):
        overrides = ["+sweep=gamma", *overrides]
    trace(compose_config(overrides), given.table, row, metrics[0])


def verify(arguments: list[str]) -> None:
    """Score a sweep's stored checkpoints again and compare every digit with the store."""
    parser = _parser("verify", verify.__doc__)
    parser.add_argument("overrides", nargs="*", help="as for tables, such as +sweep=gamma profile=quick")
    parser.add_argument("--from-weights", action="store_true", help="run the networks too, where weights were kept")
    given = parser.parse_intermixed_args(arguments)
    from fl3d.evidence import verify as check

    check(compose_config(given.overrides or ["+sweep=gamma"]), given.from_weights)


def clean(arguments: list[str]) -> None:
    """Show what the store can do without: weights beyond the retention rule, left-overs. Removes it with --yes only."""
    parser = _parser("clean", clean.__doc__)
    parser.add_argument("--root", type=Path, default=Path("runs"), help="folder of the store (default: runs)")
    parser.add_argument("--keep-every", type=int, default=10, metavar="K", help="keep each K-th epoch; 0: none (10)")
    parser.add_argument("--orphans", action="store_true", help="also stages that no sweep's plan names any more")
    parser.add_argument("--yes", action="store_true", help="remove it")
    given = parser.parse_args(arguments)
    from fl3d.cleaning import clean as tidy

    tidy(given.root, given.keep_every or None, given.yes, given.orphans)


def evaluate(arguments: list[str]) -> None:
    """Evaluate a folder of KITTI result files (NNNNNN.txt), whoever wrote them, by KITTI's official rules.

    The frames evaluated are those that have a result file; the results are taken as they are.
    """
    parser = _parser("evaluate", evaluate.__doc__)
    parser.add_argument("labels", type=Path, metavar="LABELS", help="folder of label files, such as training/label_2")
    parser.add_argument("results", type=Path, metavar="RESULTS", help="folder of result files, one a frame")
    protocols = sorted(path.stem for path in (CONF / "protocol").glob("*.yaml"))
    parser.add_argument("--protocol", default="kitti", choices=protocols, help="overlaps and variant (default: kitti)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="thresholds, counts, precisions and AP in full")
    options = parser.parse_args(arguments)
    import json

    from fl3d.evaluation.average_precision import as_json
    from fl3d.evaluation.folders import curves_to_markdown, evaluate_folder
    from fl3d.evaluation.protocol import Protocol
    from fl3d.files import write_text

    protocol = Protocol(**compose_config([f"protocol={options.protocol}", "profile=paper"])["protocol"])
    curves, n_frames = evaluate_folder(options.labels, options.results, protocol)
    print(f"{n_frames} frames, protocol {protocol.name} (variant {protocol.variant}); AP in percent\n")
    print(curves_to_markdown(curves))
    if options.json:
        try:
            write_text(options.json, json.dumps(as_json(curves)) + "\n")
        except OSError as error:
            raise ConfigError(f"--json {options.json}: cannot be written ({error.strerror})") from None


def simulate(arguments: list[str]) -> None:
    """Write a simulated KITTI folder: velodyne, label_2, calib, image_2, ImageSets and 2D detections.

    Same numbers and seed, same bytes, whatever the number of workers. Interrupted, the same command goes on.

    Example: python -m fl3d simulate data/street --frames 1500 --seed 7
    """
    from fl3d.data.simulator.generate import Settings, write_folder

    parser = _parser("simulate", simulate.__doc__)
    parser.add_argument("out", type=Path, metavar="OUT", help="the folder; training/ and ImageSets/ come into it")
    parser.add_argument("--frames", type=_at_least_one, default=700, metavar="N", help="all of them (default: 700)")
    parser.add_argument("--val", type=_count, metavar="N", help="of them in the validation split (default: 3 of 7)")
    parser.add_argument("--seed", type=_count, default=0, help="of all randomness (default: 0)")
    parser.add_argument("--no-pictures", action="store_true", help="leave image_2 out: six times faster")
    parser.add_argument("--whole-turn", action="store_true", help="clouds all around, not what the camera sees alone")
    parser.add_argument("--workers", type=_at_least_one, metavar="N", help="processes (default: one a core)")
    options = parser.parse_args(arguments)
    val = options.frames * 3 // 7 if options.val is None else options.val
    if val > options.frames:
        parser.error(f"--val {val} is more than --frames {options.frames}")
    settings = Settings(options.frames - val, val, options.seed, not options.no_pictures, options.whole_turn)
    write_folder(options.out, settings, options.workers)
    print(options.out)


def predict(arguments: list[str]) -> None:
    """Let a trained detector look at clouds: writes KITTI result files, and a picture of each cloud with its boxes."""
    parser = _parser("predict", predict.__doc__)
    parser.add_argument("checkpoint", type=Path, help="a stage's folder, runs/stages/NAME (its last), or its .pt file")
    parser.add_argument("clouds", type=Path, help="a .bin file, a folder of them, or a KITTI folder")
    parser.add_argument("--out", type=Path, default=Path("predictions"), help="folder (default: predictions)")
    parser.add_argument("--score", type=float, default=0.5, help="boxes from this posterior on (default: 0.5)")
    parser.add_argument("--calib", type=Path, help="of clouds that have none beside them (default: KITTI's mean)")
    parser.add_argument("--device", default="cpu", help="cpu or cuda (default: cpu)")
    parser.add_argument("--no-pictures", action="store_true", help="write result files alone")
    given = parser.parse_args(arguments)
    from fl3d.predict import predict as look

    drawn = not given.no_pictures
    look(given.checkpoint, given.clouds, given.out, given.score, given.calib, given.device, drawn)


def ui(arguments: list[str]) -> None:
    """Browse the store in MLflow's user interface, on this machine alone."""
    from fl3d.errors import StoreError
    from fl3d.store.tracking import Store

    parser = _parser("ui", ui.__doc__)
    parser.add_argument("--root", type=Path, default=Path("runs"), help="folder of the store (default: runs)")
    parser.add_argument("--uri", help="of another store, as store.uri of the sweep: postgresql://USER@HOST/NAME")
    parser.add_argument("--port", type=int, default=5000, help="default: 5000")
    options = parser.parse_args(arguments)
    store = Store(options.root, options.uri)
    if store.is_server:
        _print_views(store, store.uri)
        return
    if not store.exists:
        raise StoreError(f"{options.root}: there is no store yet; run a sweep first, such as: make sweep-gamma")
    _print_views(store, f"http://127.0.0.1:{options.port}")
    print("Ctrl-C ends it.", flush=True)
    command = [sys.executable, "-m", "mlflow", "ui", "--backend-store-uri", store.uri]
    subprocess.run([*command, "--host", "127.0.0.1", "--port", str(options.port)], check=False)


def _print_views(store: Store, address: str) -> None:
    store.open()
    print(f"Open {address}/#/experiments?workflowType=machine_learning, or the curves of one sweep:")
    for name, view in store.views().items():
        print(f"  {name:32s} {address}/{view}")


def stage(arguments: list[str]) -> None:
    """Train one planned stage from its folder, in this process: what launchers start, for debuggers."""
    parser = _parser("stage", stage.__doc__)
    parser.add_argument("folder", type=Path, help="runs/stages/<key>")
    from fl3d.training.run import run_stage

    run_stage(parser.parse_args(arguments).folder)


COMMANDS: dict[str, Callable[[list[str]], None]] = {
    "plan": plan,
    "tables": tables,
    "figures": figures,
    "report": report,
    "rescore": rescore,
    "gains": gains,
    "why": why,
    "verify": verify,
    "clean": clean,
    "evaluate": evaluate,
    "simulate": simulate,
    "predict": predict,
    "ui": ui,
    "stage": stage,
}


def _parser(name: str, description: str | None) -> argparse.ArgumentParser:
    return argparse.ArgumentParser(prog=f"python -m fl3d {name}", description=description)


def _count(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least 0")
    return int(text)


def _at_least_one(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least 1")
    return int(text)
