"""The command `bench`: what this machine achieves, one figure's worth or all of it as a file."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from station.cli.options import between, progress_bar

WHAT = (
    "model", "accuracy", "solver", "cost", "tick", "wire", "loop", "headless", "cold", "recorder", "setpoints",
    "gym", "report",
)  # fmt: skip


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add it."""
    bench = commands.add_parser("bench", help="measure this machine")
    bench.add_argument("what", choices=WHAT, help="'report': all but accuracy, solver and gym, into a file")
    bench.add_argument(
        "--seconds",
        type=between(1.0, 86400.0, "a time", "s"),
        default=60.0,
        metavar="S",
        help="of loop, recorder, setpoints (60)",
    )
    bench.add_argument("--no-fifo", action="store_true", help="of 'loop': do not ask for real-time scheduling")
    bench.add_argument("--json", action="store_true", help="print one JSON object")
    bench.add_argument(
        "--out", type=Path, default=Path("MEASURED.md"), metavar="FILE", help="of 'report' (MEASURED.md)"
    )
    bench.set_defaults(command=_bench)


def _bench(parsed: argparse.Namespace) -> int:
    from rich.console import Console

    from station.bench.bench import table

    if parsed.what == "report":
        return _report(parsed.out)
    result = _measured(parsed)
    if parsed.json:
        sys.stdout.write(f"{json.dumps(result)}\n")
    else:
        Console(highlight=False).print(table(parsed.what, result))
    return 0


def _measured(parsed: argparse.Namespace) -> dict[str, Any]:
    from station.bench import accuracy, bench, cold, gym, loop, recorder, setpoints, solver, tick, wire

    with progress_bar() as bar:
        task = bar.add_task(f"bench {parsed.what}", total=1.0)

        def progress(done: float) -> None:
            bar.update(task, completed=done)

        match parsed.what:
            case "loop":
                return loop.loop(parsed.seconds, progress, fifo=not parsed.no_fifo)
            case "recorder":
                return recorder.recorder(parsed.seconds)
            case "setpoints":
                return setpoints.setpoints(parsed.seconds, progress)
            case "accuracy":
                return accuracy.accuracy(progress)
            case "solver":
                return solver.solver(done=progress)
            case "cost":
                return accuracy.cost()
            case "tick":
                return tick.tick()
            case "wire":
                return wire.wire()
            case "headless":
                return bench.headless()
            case "gym":
                return gym.gym()
            case "cold":
                return cold.cold()
            case _:
                return bench.model()


def _report(out: Path) -> int:
    from station.bench.report import MEASURES, machine, measured, text

    where = machine()  # the loop keeps to one processor and leaves a load behind
    with progress_bar() as bar:
        task = bar.add_task("bench report", total=len(MEASURES))
        found = dict(measured(lambda name: bar.update(task, advance=1.0, description=f"bench {name}")))
    try:
        out.write_text(text(where, found), encoding="utf-8")
    except OSError as error:
        sys.stderr.write(f"{out}: cannot be written: {error.strerror}\n")
        return 1
    sys.stdout.write(f"{out}\n")
    return 0
