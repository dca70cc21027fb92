"""The command `run`: run the cases of an experiment, in parallel in virtual time or one by one in real time."""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from station.cli.options import add_without, command_line_path, count, data_folder, progress_bar, seed

if TYPE_CHECKING:
    from station.experiments.experiment import Experiment
    from station.experiments.output import CaseAssignment, RecordedResult
    from station.jobs.processes import Processes


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `run` to the parser."""
    run = commands.add_parser("run", help="run an experiment with simulated devices and print its results")
    run.add_argument("experiment", metavar="EXPERIMENT", help="name of a preset or a .toml file")
    run.add_argument(
        "--seed", type=seed, default=0, metavar="N", help="seed of all random numbers of the lab (default: 0)"
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
        help="new value of a key of the experiment's file, e.g. controller.k1=2.5; may be repeated",
    )  # fmt: skip
    run.add_argument(
        "--jobs", type=count(1024), metavar="N", help="number of parallel cases (default: one per processor)"
    )
    run.add_argument("--realtime", action="store_true", help="run in real time instead of as fast as possible")
    run.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    run.set_defaults(command=_run)


def _run(parsed: argparse.Namespace) -> int:
    from station.jobs.processes import Processes, processors

    count = 1 if parsed.realtime else parsed.jobs or processors()
    if count == 1:
        return _run_experiment(parsed, None)
    with Processes(count) as started:
        # Load or compile the code of the lab and the controller while the experiment is read and checked on the model.
        from station.experiments.runner import warm_up

        started.prepare(warm_up)
        return _run_experiment(parsed, started)


def _run_experiment(parsed: argparse.Namespace, started: "Processes | None") -> int:
    from station.config.strict import ConfigError, use_experiments
    from station.control.monitors import Margins, check_design
    from station.experiments.best_possible import with_bound
    from station.experiments.experiment import load_experiment
    from station.experiments.output import ResultFolder, result_table
    from station.experiments.saved import use_saved
    from station.experiments.sweep_plan import nested, settings
    from station.recording.headline import headline

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
    for text in dict.fromkeys(text for case in experiment.cases for text in (*case.notices, *case.warnings)):
        names = ", ".join(case.name for case in experiment.cases if text in (*case.notices, *case.warnings))
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
        first = headline(summary)
        summary = {"headline": None if first is None else first.model_dump(), **summary}
        folder.finish(summary, [one.label for one in recorded])
    except BaseException:
        folder.abandon()
        raise
    if parsed.json:
        print(json.dumps(summary))  # noqa: T201
    else:
        out = Console(highlight=False, markup=False)
        if first is not None:
            out.print(str(first), soft_wrap=True)
        out.print(result_table(experiment, summary))
        speed = summary["simulated_s"] / max(summary["wall_s"], 1e-3)
        out.print(
            f"{summary['simulated_s']:.0f} s simulated in {summary['wall_s']:.1f} s ({speed:.2g} times real time),"
            f" seed {parsed.seed}\n{folder.path}",
            soft_wrap=True,
        )
    return 0 if completed else 1


def _bounds(
    experiment: "Experiment", seed: int, started: "Processes | None"
) -> "Mapping[str, Mapping[str, float | None]]":
    """Return the best possible errors of the cases by name; cases with equal bounds share one computation."""
    from station.experiments.best_possible import bound, cases_to_bound, has_bound, same_bound
    from station.jobs.run_jobs import run_jobs

    jobs, found = cases_to_bound(experiment.cases, seed), dict[str, Mapping[str, float | None]]()
    with progress_bar() as bar:
        task = bar.add_task(f"{experiment.name} bounds", total=max(1.0, len(jobs)), visible=bool(jobs))
        run_jobs(
            bound, jobs, started, found,
            lambda running: bar.update(task, completed=len(found) + sum(running.values())),
        )  # fmt: skip
    if len(found) < len(jobs):
        raise KeyboardInterrupt
    keys = {case.name: same_bound(case) for case in experiment.cases if has_bound(case)}
    return {name: found[key] for name, key in keys.items() if key in found}


def _run_cases(
    name: str, assignments: Sequence["CaseAssignment"], started: "Processes | None", *, realtime: bool
) -> list["RecordedResult"]:
    """Run each case with a progress bar; do not start another case after one that was not completed."""
    from station.control.clock import RealClock
    from station.experiments.output import run_recorded
    from station.jobs.run_jobs import run_jobs

    found = dict[int, "RecordedResult"]()
    with progress_bar() as bar:
        tasks = [bar.add_task(f"{name} {one.case.name}", total=1.0) for one in assignments]

        def report(running: Mapping[int, float]) -> None:
            for number, task in enumerate(tasks):
                bar.update(task, completed=1.0 if number in found else running.get(number, 0.0))

        work = partial(run_recorded, clock=RealClock) if realtime else run_recorded
        run_jobs(work, dict(enumerate(assignments)), started, found, report, proceed=lambda one: one.completed)
    return [found[number] for number in sorted(found)]
