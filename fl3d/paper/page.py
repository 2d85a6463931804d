"""Everything of one sweep on one page, in its results folder, and beside its trials in MLflow."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from fl3d.config import compose_config
from fl3d.errors import DataError, StoreError
from fl3d.evaluation.protocol import Protocol
from fl3d.files import write_text
from fl3d.gains import compare_sweep, gains
from fl3d.paper.claims import claims_of
from fl3d.paper.figures import write_figures
from fl3d.paper.honest import write_honest
from fl3d.paper.index import write_index
from fl3d.paper.report_figures import feeds, write_report_figures
from fl3d.paper.tables import refuse_without_tables, stored_sweeps, write_still_tables, write_views
from fl3d.records import Config, StagePaths
from fl3d.reports.page import Section, folded, link, listing, page, paragraph, picture, preformatted
from fl3d.reports.published import REPORT_TABLES
from fl3d.reports.render import to_html
from fl3d.reports.table import Table
from fl3d.reports.write import NAMED, write_tables
from fl3d.rescore import finished_trials, stored_with_validation
from fl3d.results import names, report_from_store, results_folder
from fl3d.store.tracking import Store
from fl3d.training.checkpoints import read_marker

CAPTIONS = {
    "figure_1_3dfcn": "Figure 1. 3D-FCN: BCE above, focal loss below; ground truth purple, estimates blue.",
    "figure_1_voxelnet": "Figure 1. VoxelNet: BCE above, focal loss below; ground truth purple, estimates blue.",
    "ap_over_gamma": "AP of the last models against γ; bars: 95 % intervals of 3D moderate; thin lines: γ = 0.",
    "ap_over_steps": "3D AP moderate of every checkpoint; the dotted line is where the focal loss sets in.",
    "best_of_k": "Mean of the best of k checkpoints of a trial's whole curve: much of the rise is training itself.",
    "precision_recall": "Precision against recall of the last models, 3D moderate.",
    "ap_over_cut": "3D AP moderate against the score below which detections are dropped.",
    "figure_4": "Figure 4. Cumulative normalised loss of the best focal models' windows, under each γ.",
    "figure_5": "Figure 5. Posterior probability of positive windows, last models.",
    "report_figure_4_pointrcnn": "Report, as Figure 4, of PointRCNN: overlap over epochs; dotted: second stage.",
    "report_figure_6_pointrcnn": "Report, as Figure 6, of PointRCNN: proposals above, refined boxes below.",
    "report_figure_4_fconvnet": "Report, Figure 4: overlap of cars over epochs; dotted: refinement sets in.",
    "report_figure_6_fconvnet": "Report, Figures 6 and 7: Frustum ConvNet before and after refinement.",
    "report_figure_8": "Report, Figure 8: 2D detections against ground truth.",
    "imbalance_by_height": "Positive windows of 3D-FCN by height, and how many negatives stand against each (§III-B).",
}


def write_page(overrides: list[str], say: Callable[[str], None] = print) -> Path:
    """Make tables, figures and claims of a sweep over gamma, and one page of them.

    Args:
        overrides: of the config; the sweep must be one over gamma (default: ``+sweep=gamma``).
        say: prints a line for the user.

    Raises:
        StoreError: the sweep was never run here.
    """
    chosen = any(override.startswith("+sweep=") for override in overrides)
    config = compose_config(overrides if chosen else [*overrides, "+sweep=gamma"])

    refuse_without_tables(config)
    stored_with_validation(finished_trials(config)[0], {})  # what cannot be made is not begun

    def quiet(line: str) -> None:
        if line.startswith(("Written", "From", "No ")):
            say(line)

    tables, scores = report_from_store(config, quiet)
    views = write_views(config, tables, scores, quiet)
    stored = stored_sweeps([o for o in overrides if not o.startswith("+sweep=")])
    others = [other for other in stored if other["sweep"]["name"] != config["sweep"]["name"]]
    for other in others:  # Table V, the report's
        more_tables, more_scores = report_from_store(other, quiet)
        tables = [table for table in tables if table.name not in {more.name for more in more_tables}] + more_tables
        views += write_views(other, more_tables, more_scores, quiet)
    reported = [path for other in others if feeds(other) for path in _report_figures(other, say)]
    still = write_still_tables(results_folder(config), quiet)
    pictures = {path.stem: path for path in write_figures(overrides, quiet) if path.suffix == ".png"}
    honest, more = write_honest(config, scores)
    pictures |= {path.stem: path for path in [*more, *reported] if path.suffix == ".png"}
    claims = claims_of(config, scores)
    write_tables([claims], results_folder(config))
    path = results_folder(config) / "report.html"
    sections = [
        Section("In short", (listing(_findings(config)),)),
        Section("Tables", _tables(tables, views)),
        Section("Figures", tuple(picture(pictures[name], text) for name, text in CAPTIONS.items() if name in pictures)),
        Section("Claims of the paper", (to_html(claims),)),
        Section("Last, best and honest best", (to_html(honest),)),
        Section("Networks", tuple(to_html(table) for table in still)),
        Section("Plan and provenance", _provenance(config, overrides)),
    ]
    sweep = config["sweep"]
    write_text(path, page(f"{sweep['name']}: {names(config).results}", sweep["question"] or "", sections))
    _attach(config, path)
    say(f"Written to {path}; {write_index(Path(config['results']))}.")
    return path


def _report_figures(config: Config, say: Callable[[str], None]) -> list[Path]:
    """The report's figures, or those drawn before: scores are kept with results, the store may be elsewhere."""
    try:
        return write_report_figures(config, say)
    except (DataError, StoreError) as error:
        say(f"No new figures of {config['sweep']['name']}: {error}")
        return sorted((results_folder(config) / "figures").glob("report_figure_*.png"))


def _findings(config: Config) -> list[str]:
    """For each detector, which gains of the last models are sure, on the surest of the averages."""
    table = gains(compare_sweep(config))
    own = table[(table["metric"] == "3d") & (table["difficulty"] == "moderate") & (table["average"] == "R40")]
    found = []
    for detector, rows in own.groupby("detector"):
        base = rows[rows["gamma"] == 0].iloc[0]
        interval = f"{base['ap']:.1f} [{base['ap_low']:.1f}, {base['ap_high']:.1f}]"
        sure = rows[rows["sure"] & (rows["gamma"] > 0)]
        parts = [f"γ = {r.gamma:g}: {r.gain:+.1f} [{r.gain_low:+.1f}, {r.gain_high:+.1f}]" for r in sure.itertuples()]
        told = "sure gains or losses: " + "; ".join(parts) if parts else "no gain or loss of any γ is sure"
        found.append(f"{detector}: 3D AP moderate (R40) {interval} with BCE; {told}.")
    seeds = int(own["seeds"].max())
    over = "frames; one seed of training" if seeds == 1 else f"frames and {seeds} seeds of training"
    return [*found, f"Intervals of 95 % over {over}."]


def _tables(tables: list[Table], views: list[Table]) -> tuple[str, ...]:
    """Each table with intervals, the other forms folded below it."""
    parts = []
    for table in sorted(tables, key=_place):
        own = {view.name.partition("_")[2]: view for view in views if view.number == table.number}
        parts.append(to_html(own.get("intervals", table)))
        if "published" in own:
            parts.append(folded(f"Table {table.number} beside the published one", to_html(own["published"])))
        if own:
            parts.append(folded(f"Table {table.number} as the paper prints it", to_html(table)))
    return tuple(parts)


def _place(table: Table) -> tuple[bool, bool, str]:
    """The paper's tables, those of other detectors over gamma, the report's."""
    is_report = table.number in REPORT_TABLES
    return is_report, table.name.startswith("gamma"), table.number if is_report else ""


def _provenance(config: Config, overrides: list[str]) -> tuple[str, ...]:
    """Commands, where the trials were made, and where MLflow shows them."""
    called, given = names(config), " ".join(o for o in overrides if not o.startswith("+sweep="))
    sweep = f"+sweep={config['sweep']['name']}"
    command = f"python -m fl3d -m {sweep} {given}\npython -m fl3d report {sweep} {given}"
    root = Path(config["store"]["root"])
    keys = {key for trial in json.loads(called.plan(root).read_text())["trials"] for key in trial["stages"]}
    stages, made = [], set()
    for paths in [StagePaths(root / "stages" / key) for key in sorted(keys)]:
        if not paths.done.exists():
            continue
        spec = json.loads(paths.spec.read_text())["stage"]
        marker = read_marker(paths, paths.steps()[-1]).made_by
        commit = marker.get("mlflow.source.git.commit", "unknown")[:12]
        made.add(f"commit {commit}{' with changes' if 'fl3d.diff' in marker else ''}; {marker.get('fl3d.machine', '')}")
        made.add(marker.get("fl3d.packages", ""))
        epochs = f"{spec['epochs']} epochs of {spec['epoch_steps']} steps"
        stages.append(f"{spec['key']}: {epochs} from step {spec['start_step']}")
    protocol = Protocol(**config["protocol"])
    address = "http://127.0.0.1:5000/#/experiments?workflowType=machine_learning"
    return (
        preformatted(command),
        listing(sorted(made - {""})),
        paragraph(f"Protocol {protocol.id}: {json.dumps(config['protocol'])}"),
        folded("Stages", preformatted("\n".join(stages))),
        link(address, f"In MLflow (make ui): experiment {called.experiment}"),
    )


def _attach(config: Config, path: Path) -> None:
    """Put the page beside every trial."""
    store = Store(Path(config["store"]["root"]), config["store"]["uri"])
    if not store.exists:
        return
    raw: pd.DataFrame = store.read(names(config).experiment, list(NAMED))
    if raw.empty:
        return
    raw = raw[raw["tags.fl3d.protocol"] == Protocol(**config["protocol"]).id]
    done = {paths.folder.name for paths in finished_trials(config)}
    store.open()
    for run in sorted(set(raw[raw["tags.fl3d.trial"].isin(done)]["run_uuid"])):
        store.log_files(str(run), [path], "results")
