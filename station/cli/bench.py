"""The command `bench`: run one benchmark on this computer, or write a report of all benchmarks to a file."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from station.cli.options import number_between, progress_bar

BENCHMARKS = (
    "model", "accuracy", "solver", "cost", "tick", "wire", "loop", "headless", "cold", "rest", "recorder", "setpoints",
    "gym", "report",
)  # fmt: skip


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `bench` to the parser."""
    bench = commands.add_parser("bench", help="measure the performance of this computer")
    bench.add_argument("what", choices=BENCHMARKS, help="'report' writes all but accuracy, solver and gym to a file")
    bench.add_argument(
        "--seconds",
        type=number_between(1.0, 86400.0, "a time", "s"),
        default=60.0,
        metavar="S",
        help="duration of each of the benchmarks loop, rest, recorder and setpoints [s] (default: 60)",
    )
    bench.add_argument("--no-fifo", action="store_true", help="loop: do not request real-time scheduling")
    bench.add_argument("--json", action="store_true", help="print one JSON object")
    bench.add_argument(
        "--out",
        type=Path,
        default=Path("MEASURED.md"),
        metavar="FILE",
        help="file that 'report' writes (default: MEASURED.md)",
    )
    bench.set_defaults(command=_bench)


def _bench(parsed: argparse.Namespace) -> int:
    from rich.console import Console

    from station.benchmarks.bench import table

    if parsed.what == "report":
        return _report(parsed.out)
    result = _measure(parsed)
    if parsed.json:
        sys.stdout.write(f"{json.dumps(result)}\n")
    else:
        Console(highlight=False).print(table(parsed.what, result))
    return 0


def _measure(parsed: argparse.Namespace) -> dict[str, Any]:
    from station.benchmarks import accuracy, bench, cold, loop, recorder, rest, setpoints, solver, wire

    with progress_bar() as bar:
        task = bar.add_task(f"bench {parsed.what}", total=1.0)

        def progress(done: float) -> None:
            bar.update(task, completed=done)

        match parsed.what:
            case "loop":
                return loop.loop(parsed.seconds, progress, fifo=not parsed.no_fifo)
            case "recorder":
                return recorder.recorder(parsed.seconds)
            case "rest":
                return rest.rest(parsed.seconds, progress)
            case "setpoints":
                return setpoints.setpoints(parsed.seconds, progress)
            case "accuracy":
                return accuracy.accuracy(progress)
            case "solver":
                return solver.solver(done=progress)
            case "cost":
                return accuracy.cost()
            case "tick":
                return bench.tick()
            case "wire":
                return wire.wire()
            case "headless":
                return bench.headless()
            case "gym":
                return bench.gym()
            case "cold":
                return cold.cold()
            case _:
                return bench.model()


def _report(out: Path) -> int:
    from station.benchmarks.report import MEASURES, describe_machine, measure_all, measured_markdown

    where = (
        describe_machine()
    )  # describe the computer before the benchmarks: they raise its load, and one binds this process to one processor
    with progress_bar() as bar:
        task = bar.add_task("bench report", total=len(MEASURES))
        found = dict(measure_all(lambda name: bar.update(task, advance=1.0, description=f"bench {name}")))
    try:
        out.write_text(measured_markdown(where, found), encoding="utf-8")
    except OSError as error:
        sys.stderr.write(f"{out}: cannot be written: {error.strerror}\n")
        return 1
    sys.stdout.write(f"{out}\n")
    return 0
