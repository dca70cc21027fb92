"""The command `run`: run the cases of an experiment, in parallel in virtual time or one by one in real time."""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from station.cli.options import add_without, command_line_path, count, data_folder, progress_bar, seed

if TYPE_CHECKING:
    from station.experiments.experiment import Experiment
    from station.experiments.job_pool import JobPool
    from station.experiments.output import CaseAssignment, RecordedResult


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `run` to the parser."""
    run = commands.add_parser("run", help="run an experiment with simulated devices and print its results")
    run.add_argument("experiment", metavar="EXPERIMENT", help="name of a preset or a .toml file")
    run.add_argument(
        "--seed", type=seed, default=0, metavar="N", help="seed of everything random in the lab (default: 0)"
    )
    run.add_argument("--out", type=Path, metavar="DIR", help="folder of results (default: the data folder)")
    run.add_argument("--experiments", type=Path, metavar="DIR", help="folder of custom experiments")
    run.add_argument("--calibration", type=Path, metavar="DIR", help="folder with the results of 'calibrate'")
    run.add_argument("--lab", metavar="LAB", help="virtual lab instead of the experiment's: preset or .toml file")
    run.add_argument("--robot", metavar="ROBOT", help="robot instead of the experiment's: preset or .toml file")
    add_without(run)
    run.add_argument("--case", metavar="NAME", help="only this case of the experiment")
    run.add_argument(
        "--set", action="append", default=[], dest="settings", metavar="KEY=VALUE",
        help="another value of a key of the experiment's file, e.g. controller.k1=2.5; may be repeated",
    )  # fmt: skip
    run.add_argument(
        "--jobs", type=count(1024), metavar="N", help="number of parallel cases (default: one per processor)"
    )
    run.add_argument("--realtime", action="store_true", help="run in real time instead of as fast as possible")
    run.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    run.set_defaults(command=_run)


def _run(parsed: argparse.Namespace) -> int:
    from station.experiments.job_pool import JobPool, processors

    jobs = 1 if parsed.realtime else parsed.jobs or processors()
    if jobs == 1:
        return _run_experiment(parsed, None)
    with JobPool(jobs) as started:
        # Load or compile the code of the lab and the controller while the experiment is read and checked on the model.
        from station.experiments.runner import warm_up

        started.prepare(warm_up)
        return _run_experiment(parsed, started)


def _run_experiment(parsed: argparse.Namespace, started: "JobPool | None") -> int:
    from station.config.strict import ConfigError, use_experiments
    from station.control.monitors import Margins, check_design
    from station.experiments.best_possible import with_bound
    from station.experiments.case_summary import model_note
    from station.experiments.experiment import load_experiment
    from station.experiments.output import ResultFolder, result_table
    from station.experiments.saved import use_saved
    from station.experiments.sweep_plan import nested, settings

    if parsed.experiments is not None:
        use_experiments(parsed.experiments)
    use_saved(data_folder(parsed))
    given = {"robot": parsed.robot, "lab": parsed.lab, "calibration": parsed.calibration}
    chosen = settings(parsed.settings)
    if len(chosen) > 1:
        raise ConfigError("--set KEY=A,B gives several values, but 'run' uses one; 'sweep' runs all of them")
    changes = nested(
        (*chosen[0], *((key, command_line_path(value)) for key, value in given.items() if value is not None))
    )
    if parsed.without:
        changes = {**changes, "without": parsed.without}
    experiment = load_experiment(parsed.experiment, changes, only=parsed.case)
    for robot in {case.robot.name: case.robot for case in experiment.cases}.values():
        if warning := check_design(robot, Margins()):
            sys.stderr.write(f"ctr-station: {warning}\n")
    for note in dict.fromkeys(note for case in experiment.cases if (note := model_note(case))):
        sys.stderr.write(f"ctr-station: {note}\n")
    for text in dict.fromkeys(text for case in experiment.cases for text in case.warnings):
        names = ", ".join(case.name for case in experiment.cases if text in case.warnings)
        sys.stderr.write(f"ctr-station: {names}: {text}\n")
    folder = ResultFolder(parsed.out or data_folder(parsed), experiment, parsed.seed)
    start_time = time.perf_counter()
    try:
        assignments = [folder.assignment(case) for case in experiment.cases]
        bounds = _bounds(experiment, parsed.seed, started)
        recorded = _run_cases(experiment.name, assignments, started, realtime=parsed.realtime)
        completed = len(recorded) == len(assignments) and all(one.completed for one in recorded)
        summary: dict[str, Any] = {
            "experiment": experiment.name,
            "seed": parsed.seed,
            "lab": experiment.cases[0].lab.title,
            "completed": completed,
            "simulated_s": round(sum(one.numbers["simulated_s"] for one in recorded), 3),
            "wall_s": round(time.perf_counter() - start_time, 3),
            "recording": str(folder.path),
            "cases": {one.name: with_bound(one.numbers, bounds.get(one.name, {})) for one in recorded},
        }
        folder.finish(summary, [one.label for one in recorded])
    except BaseException:
        folder.abandon()
        raise
    if parsed.json:
        print(json.dumps(summary))  # noqa: T201
    else:
        out = Console(highlight=False, markup=False)
        out.print(result_table(experiment, summary))
        speed = summary["simulated_s"] / max(summary["wall_s"], 1e-3)
        out.print(
            f"{summary['simulated_s']:.0f} s simulated in {summary['wall_s']:.1f} s ({speed:.0f} times real time),"
            f" seed {parsed.seed}\n{folder.path}",
            soft_wrap=True,
        )
    return 0 if completed else 1


def _bounds(
    experiment: "Experiment", seed: int, started: "JobPool | None"
) -> "Mapping[str, Mapping[str, float | None]]":
    """Return the best possible errors of the cases that have them, by case name; compute each load once."""
    from station.experiments.best_possible import bound, cases_to_bound, has_bound, same_bound
    from station.experiments.job_pool import run_serially

    to_compute = cases_to_bound(experiment.cases, seed)
    with progress_bar() as bar:
        task = bar.add_task(f"{experiment.name} bounds", total=max(1.0, len(to_compute)), visible=bool(to_compute))

        def progress(parts: Sequence[float]) -> None:
            bar.update(task, completed=sum(parts))

        listed = list(to_compute.values())
        found = (
            started.carry_out(bound, listed, progress)
            if started is not None
            else run_serially(bound, listed, progress, lambda _: True)
        )
    by_key = dict(zip(to_compute, found, strict=False))  # after Ctrl-C the bounds of some cases are missing
    keys = {case.name: same_bound(case) for case in experiment.cases if has_bound(case)}
    return {name: by_key[key] for name, key in keys.items() if key in by_key}


def _run_cases(
    name: str, assignments: Sequence["CaseAssignment"], started: "JobPool | None", *, realtime: bool
) -> list["RecordedResult"]:
    """Run each case with a progress bar; do not start another case after one that was not completed."""
    from station.control.clock import RealClock, VirtualClock
    from station.experiments.job_pool import run_serially
    from station.experiments.output import run_recorded

    with progress_bar() as bar:
        tasks = [bar.add_task(f"{name} {one.case.name}", total=1.0) for one in assignments]

        def progress(parts: Sequence[float]) -> None:
            for task, part in zip(tasks, parts, strict=True):
                bar.update(task, completed=part)

        if started is not None:
            return started.carry_out(run_recorded, assignments, progress, lambda one: one.completed)
        return run_serially(
            lambda one, report: run_recorded(one, report, RealClock() if realtime else VirtualClock()),
            assignments, progress, lambda one: one.completed,
        )  # fmt: skip
