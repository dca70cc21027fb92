"""The command `sweep`: an experiment with many seeds and settings, side by side in processes."""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from station.cli.options import count, data_of, from_here, progress_bar
from station.experiments.side_by_side import processors


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add it."""
    sweep = commands.add_parser("sweep", help="an experiment with many seeds and settings: one table, one report")
    sweep.add_argument("experiment", metavar="EXPERIMENT", help="name of a preset or a .toml file")
    sweep.add_argument("--seeds", type=count(100_000), default=20, metavar="N", help="seeds 0 ... N-1 (20)")
    sweep.add_argument(
        "--set", action="append", default=[], dest="settings", metavar="KEY=A,B,C",
        help="a key of the experiment's file and its values, e.g. controller.k1=1,2.5,5; of several: all combinations",
    )  # fmt: skip
    sweep.add_argument("--lab", metavar="LAB", help="virtual lab instead of the experiment's: preset or .toml file")
    sweep.add_argument("--case", metavar="NAME", help="only this case of the experiment")
    sweep.add_argument(
        "--jobs", type=count(1024), default=processors(), metavar="N", help="processes (one a processor)"
    )
    sweep.add_argument("--out", type=Path, metavar="DIR", help="where results go (the folder of data)")
    sweep.add_argument("--experiments", type=Path, metavar="DIR", help="folder of your own experiments")
    sweep.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    sweep.set_defaults(command=_sweep)


def _sweep(parsed: argparse.Namespace) -> int:
    from rich.console import Console

    from station.config.strict import use_experiments
    from station.experiments.experiment import load_experiment
    from station.experiments.saved import use_saved
    from station.experiments.sweep import jobs, sweep, sweep_summary
    from station.experiments.sweep_output import sweep_table, write_sweep
    from station.experiments.sweep_settings import settings
    from station.report.page import write_report

    if parsed.experiments is not None:
        use_experiments(parsed.experiments)
    use_saved(data_of(parsed))
    begin = time.perf_counter()
    lab = [] if parsed.lab is None else [f"lab='{from_here(parsed.lab)}'"]
    chosen = settings([*parsed.settings, *lab])
    experiment = load_experiment(parsed.experiment)
    listed = jobs(parsed.experiment, chosen, range(parsed.seeds), parsed.case)
    with progress_bar() as bar:
        task = bar.add_task(f"sweep {experiment.name}", total=len(listed))
        outcomes = sweep(listed, min(parsed.jobs, len(listed)), lambda done: bar.update(task, completed=done))
    summary = sweep_summary(experiment, listed, outcomes, time.perf_counter() - begin)
    folder = write_sweep(parsed.out or data_of(parsed), summary, experiment.source)
    write_report(folder)
    if parsed.json:
        sys.stdout.write(f"{json.dumps({**summary, 'recording': str(folder)})}\n")
    else:
        out = Console(highlight=False, markup=False)
        out.print(sweep_table(summary))
        out.print(f"{len(outcomes)} of {len(listed)} runs in {summary['wall_s']:.1f} s\n{folder}", soft_wrap=True)
    return 0 if summary["completed"] else 1
