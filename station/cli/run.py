"""The command `run`: an experiment's cases side by side in virtual time, or one after the other in real time."""

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from station.cli.options import count, data_of, from_here, progress_bar, seed

if TYPE_CHECKING:
    from station.experiments.experiment import Experiment
    from station.experiments.output import Assignment, Recorded
    from station.experiments.side_by_side import Processes


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add it."""
    run = commands.add_parser("run", help="carry out an experiment with simulated devices and print how well it went")
    run.add_argument("experiment", metavar="EXPERIMENT", help="name of a preset or a .toml file")
    run.add_argument("--seed", type=seed, default=0, metavar="N", help="of everything random in the lab (0)")
    run.add_argument("--out", type=Path, metavar="DIR", help="where results go (the folder of data)")
    run.add_argument("--experiments", type=Path, metavar="DIR", help="folder of your own experiments")
    run.add_argument("--calibration", type=Path, metavar="DIR", help="use what 'calibrate' found")
    run.add_argument("--lab", metavar="LAB", help="virtual lab instead of the experiment's: preset or .toml file")
    run.add_argument("--robot", metavar="ROBOT", help="robot instead of the experiment's: preset or .toml file")
    run.add_argument("--jobs", type=count(1024), metavar="N", help="cases at a time (one a processor)")
    run.add_argument("--realtime", action="store_true", help="at the pace of the clock instead of as fast as it goes")
    run.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    run.set_defaults(command=_run)


def _run(parsed: argparse.Namespace) -> int:
    from station.experiments.side_by_side import Processes, processors

    jobs = 1 if parsed.realtime else parsed.jobs or processors()
    if jobs == 1:
        return _carry_out(parsed, None)
    with Processes(jobs) as started:
        # What the lab needs is loaded, or compiled, while the experiment is read and tried on the model.
        from station.experiments.prepare import prepare

        started.prepare(prepare)
        return _carry_out(parsed, started)


def _carry_out(parsed: argparse.Namespace, started: "Processes | None") -> int:
    from station.config.strict import use_experiments
    from station.control.margins import Margins, check_design
    from station.experiments.bound import with_bound
    from station.experiments.experiment import load_experiment
    from station.experiments.output import ResultFolder, result_table
    from station.experiments.saved import use_saved

    if parsed.experiments is not None:
        use_experiments(parsed.experiments)
    use_saved(data_of(parsed))
    given = {"robot": parsed.robot, "lab": parsed.lab, "calibration": parsed.calibration}
    changes = {key: from_here(value) for key, value in given.items() if value is not None}
    experiment = load_experiment(parsed.experiment, changes)
    for robot in {case.robot.name: case.robot for case in experiment.cases}.values():
        if warning := check_design(robot, Margins()):
            sys.stderr.write(f"ctr-station: {warning}\n")
    for text in dict.fromkeys(text for case in experiment.cases for text in case.warnings):
        names = ", ".join(case.name for case in experiment.cases if text in case.warnings)
        sys.stderr.write(f"ctr-station: {names}: {text}\n")
    folder, begin = ResultFolder(parsed.out or data_of(parsed), experiment, parsed.seed), time.perf_counter()
    try:
        assignments = [folder.assignment(case) for case in experiment.cases]
        bounds = _bounds(experiment, parsed.seed, started)
        recorded = _all_of(experiment.name, assignments, started, realtime=parsed.realtime)
        completed = len(recorded) == len(assignments) and all(one.completed for one in recorded)
        summary: dict[str, Any] = {
            "experiment": experiment.name,
            "seed": parsed.seed,
            "lab": experiment.cases[0].lab.title,
            "completed": completed,
            "simulated_s": round(sum(one.numbers["simulated_s"] for one in recorded), 3),
            "wall_s": round(time.perf_counter() - begin, 3),
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
    experiment: "Experiment", seed: int, started: "Processes | None"
) -> "Mapping[str, Mapping[str, float | None]]":
    """The bounds of the cases that have one, by case: each load is computed once."""
    from station.experiments.bound import bound, has_bound, same_bound, to_bound
    from station.experiments.side_by_side import one_after_the_other

    wanted = to_bound(experiment.cases, seed)
    with progress_bar() as bar:
        task = bar.add_task(f"{experiment.name} bounds", total=max(1.0, len(wanted)), visible=bool(wanted))

        def told(parts: Sequence[float]) -> None:
            bar.update(task, completed=sum(parts))

        listed = list(wanted.values())
        found = (
            started.carry_out(bound, listed, told)
            if started is not None
            else one_after_the_other(bound, listed, told, lambda _: True)
        )
    by_key = dict(zip(wanted, found, strict=False))  # after Ctrl-C some are missing
    keys = {case.name: same_bound(case) for case in experiment.cases if has_bound(case)}
    return {name: by_key[key] for name, key in keys.items() if key in by_key}


def _all_of(
    name: str, assignments: Sequence["Assignment"], started: "Processes | None", *, realtime: bool
) -> list["Recorded"]:
    """Carry out the cases, a progress bar each; after one that did not complete no other is begun."""
    from station.control.clock import RealClock, VirtualClock
    from station.experiments.output import run_recorded
    from station.experiments.side_by_side import one_after_the_other

    with progress_bar() as bar:
        tasks = [bar.add_task(f"{name} {one.case.name}", total=1.0) for one in assignments]

        def told(parts: Sequence[float]) -> None:
            for task, part in zip(tasks, parts, strict=True):
                bar.update(task, completed=part)

        if started is not None:
            return started.carry_out(run_recorded, assignments, told, lambda one: one.completed)
        return one_after_the_other(
            lambda one, progress: run_recorded(one, progress, RealClock() if realtime else VirtualClock()),
            assignments, told, lambda one: one.completed,
        )  # fmt: skip
