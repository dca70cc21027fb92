"""The command `sweep`: run an experiment with many seeds and settings in parallel processes."""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from core.errors import CtrError
from station.cli.options import add_workers, command_line_path, count, data_folder, progress_bar, started_workers

if TYPE_CHECKING:
    from station.experiments.sweep_plan import SweepJob, SweepPlan
    from station.jobs.manifest import Manifest, Row

#: Word that replaces the experiment's name on the command line to merge the parts of a sweep.
MERGE_WORD = "merge"
#: Largest number of parts that a sweep may be split into, for example one for each job of a cluster.
MAX_PARTS = 100_000


class SweepError(CtrError):
    """A combination of the options of `sweep` is not allowed."""


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `sweep` to the parser."""
    sweep = commands.add_parser("sweep", help="run an experiment with many seeds and settings: one table, one report")
    sweep.add_argument("experiment", metavar="EXPERIMENT", help="name of a preset or a .toml file; or 'merge'")
    sweep.add_argument("parts", nargs="?", type=Path, metavar="FOLDER", help="merge: folder of the parts")
    sweep.add_argument("--seeds", type=count(100_000), default=20, metavar="N", help="seeds 0 ... N-1 (default: 20)")
    sweep.add_argument(
        "--set", action="append", default=[], dest="settings", metavar="KEY=A,B,C",
        help="a key of the experiment's file and its values, e.g. controller.k1=1,2.5,5; if repeated: all combinations",
    )  # fmt: skip
    sweep.add_argument("--lab", metavar="LAB", help="virtual lab instead of the experiment's: preset or .toml file")
    sweep.add_argument("--case", metavar="NAME", help="only this case of the experiment")
    add_workers(sweep)
    sweep.add_argument(
        "--folder", type=Path, metavar="DIR",
        help="folder of this sweep; repeating the command continues an incomplete sweep, also without this option",
    )  # fmt: skip
    sweep.add_argument("--part", type=part, default=(1, 1), metavar="I/N", help="only this part, 1/N ... N/N")
    sweep.add_argument("--out", type=Path, metavar="DIR", help="folder of results (default: the data folder)")
    sweep.add_argument("--experiments", type=Path, metavar="DIR", help="folder of custom experiments")
    sweep.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    sweep.in_any_order = True  # allow options between positional arguments, as in `sweep merge --json FOLDER`
    sweep.set_defaults(command=_sweep)


def part(text: str) -> tuple[int, int]:
    """Parse `I/N`, part I of N parts; return both numbers."""
    number, slash, of = text.partition("/")
    if not slash:
        raise argparse.ArgumentTypeError(f"{text!r} is not I/N (part I of N parts), for example 2/4")
    parts = count(MAX_PARTS)(of)
    return count(parts)(number), parts


def _sweep(parsed: argparse.Namespace) -> int:
    from station.config.strict import use_experiments
    from station.experiments.experiment import load_experiment
    from station.experiments.saved import use_saved
    from station.experiments.sweep_folder import folder_of, sweep_manifest
    from station.experiments.sweep_plan import jobs, plan_of, settings

    if parsed.experiment == MERGE_WORD:
        return _merge(parsed)
    if parsed.parts is not None:
        raise SweepError(f"{parsed.parts}: a folder may only follow 'sweep merge'; name a sweep's folder with --folder")
    part, parts = parsed.part
    if parts > 1 and parsed.folder is None:
        raise SweepError("--part needs --folder; give all parts the same folder")
    if parsed.experiments is not None:
        use_experiments(parsed.experiments)
    use_saved(data_folder(parsed))
    start_time = time.perf_counter()
    lab = [] if parsed.lab is None else [f"lab='{command_line_path(parsed.lab)}'"]
    listed = jobs(parsed.experiment, settings([*parsed.settings, *lab]), range(parsed.seeds), parsed.case)
    plan = plan_of(load_experiment(parsed.experiment), listed, parts)
    folder = parsed.folder or folder_of(parsed.out or data_folder(parsed), plan)
    with sweep_manifest(folder, plan, part) as manifest:
        mine = {run: listed[run] for run in plan.part(part)}
        before = len(manifest.rows)
        _carry_out(mine, manifest, parsed)
        rows = [manifest.rows[run] for run in mine if run in manifest.rows]
        wall, made = time.perf_counter() - start_time, len(rows) - before
        now = f", {made} of them now," if before else ""
        headline = f"{len(rows)} of {len(mine)} runs{now} in {wall:.1f} s"
        if parts == 1:
            plan = plan.model_copy(update={"started": manifest.plan["started"]})
            return _print_results(folder, plan, rows, wall, headline, as_json=parsed.json)
    return _print_part(folder, f"part {part}/{parts}: {headline}", rows, len(mine), as_json=parsed.json)


def _carry_out(mine: "Mapping[int, SweepJob]", manifest: "Manifest[int]", parsed: argparse.Namespace) -> None:
    """Carry out the runs that the manifest does not have, with a progress bar."""
    from station.experiments.sweep import lost_job, run_job
    from station.jobs.run_jobs import run_jobs

    left = len(mine) - len(manifest.rows)
    if left == 0:
        return
    with progress_bar(over=3600.0) as bar, started_workers(parsed, left, bar) as workers:
        task = bar.add_task(parsed.experiment, total=len(mine), completed=len(manifest.rows))

        def report(running: Mapping[int, float]) -> None:
            done = len(manifest.rows)
            bad = sum(not row["completed"] for row in manifest.rows.values())
            name = f"{parsed.experiment} {done} of {len(mine)}"
            bar.update(
                task, completed=done + sum(running.values()), description=f"{name}, {bad} failed" if bad else name
            )

        run_jobs(run_job, mine, workers, manifest, report, lost=lost_job)


def _merge(parsed: argparse.Namespace) -> int:
    from station.experiments.sweep_folder import merged

    folder = parsed.parts or parsed.folder
    if folder is None:
        raise SweepError("sweep merge needs the folder of the parts")
    plan, rows = merged(folder)
    return _print_results(folder, plan, rows, 0.0, f"{len(rows)} runs of {plan.parts} parts", as_json=parsed.json)


def _print_results(
    folder: Path, plan: "SweepPlan", rows: "Sequence[Row]", wall: float, headline: str, *, as_json: bool
) -> int:
    """Write the results of a complete sweep to its folder and print them."""
    from rich.console import Console

    from station.experiments.sweep import sweep_summary
    from station.report.page import write_report
    from station.report.sweep import sweep_table, write_sweep

    summary = sweep_summary(plan, rows, wall)
    write_sweep(folder, summary, plan.source, plan.started)
    write_report(folder)
    if as_json:
        sys.stdout.write(f"{json.dumps({**summary, 'recording': str(folder)})}\n")
    else:
        out = Console(highlight=False, markup=False)
        out.print(sweep_table(summary))
        out.print(f"{headline}\n{folder}", soft_wrap=True)
    return 0 if summary["completed"] else 1


def _print_part(folder: Path, headline: str, rows: "Sequence[Row]", planned: int, *, as_json: bool) -> int:
    """Print the outcome of one part of a sweep. A part has no table; its manifest has its runs."""
    from station.report.sweep import failure_lines

    completed = len(rows) == planned and all(row["completed"] for row in rows)
    if as_json:
        sys.stdout.write(f"{json.dumps({'completed': completed, 'runs': rows, 'recording': str(folder)})}\n")
    else:
        lines = (*failure_lines(rows), headline, f"when all parts are done: ctr-station sweep merge {folder}")
        sys.stdout.write("\n".join(lines) + "\n")
    return 0 if completed else 1
