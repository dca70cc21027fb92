"""The command `bench`: run one benchmark on this computer."""

import argparse
import json
import sys
from typing import Any

from station.cli.options import number_between, progress_bar

BENCHMARKS = ("model", "tick", "headless", "loop", "rest")


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `bench` to the parser."""
    bench = commands.add_parser("bench", help="measure the performance of this computer")
    bench.add_argument("what", choices=BENCHMARKS, help="what to measure")
    bench.add_argument(
        "--seconds",
        type=number_between(1.0, 86400.0, "a time", "s"),
        default=60.0,
        metavar="S",
        help="duration of the benchmarks loop and rest [s] (default: 60)",
    )
    bench.add_argument("--no-fifo", action="store_true", help="loop: do not request real-time scheduling")
    bench.add_argument("--json", action="store_true", help="print one JSON object")
    bench.set_defaults(command=_bench)


def _bench(parsed: argparse.Namespace) -> int:
    from rich.console import Console

    from station.benchmarks.tables import table

    result = _measure(parsed)
    if parsed.json:
        sys.stdout.write(f"{json.dumps(result)}\n")
    else:
        Console(highlight=False).print(table(parsed.what, result))
    return 0


def _measure(parsed: argparse.Namespace) -> dict[str, Any]:
    from station.benchmarks import headless, loop, model, rest

    with progress_bar() as bar:
        task = bar.add_task(f"bench {parsed.what}", total=1.0)

        def progress(done: float) -> None:
            bar.update(task, completed=done)

        match parsed.what:
            case "loop":
                return loop.loop(parsed.seconds, progress, fifo=not parsed.no_fifo)
            case "rest":
                return rest.rest(parsed.seconds, progress)
            case "tick":
                return headless.tick()
            case "headless":
                return headless.headless()
            case _:
                return model.model()
