"""The command `soak`: operate a complete station at random for a long time, with device faults."""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from station.cli.options import number_between, progress_bar, seed


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `soak` to the parser."""
    soak = commands.add_parser("soak", help="test a whole station with a random operator and random faults")
    soak.add_argument(
        "--minutes",
        type=number_between(0.1, 1e5, "a time", "min"),
        default=10.0,
        metavar="N",
        help="duration [min] (default: 10)",
    )
    soak.add_argument(
        "--seed", type=seed, default=0, metavar="S", help="seed of the random actions and faults (default: 0)"
    )
    soak.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    soak.set_defaults(command=_soak)


def _soak(parsed: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.table import Table

    from station.benchmarks.soak import rows, soak

    with progress_bar() as bar, tempfile.TemporaryDirectory(prefix="ctr-soak-") as folder:
        task = bar.add_task("soak", total=1.0)
        summary = soak(60.0 * parsed.minutes, parsed.seed, Path(folder), lambda done: bar.update(task, completed=done))
    if parsed.json:
        sys.stdout.write(f"{json.dumps(summary)}\n")
    else:
        table = Table("soak", "", title=None)
        for what, text in rows(summary):
            table.add_row(what, text)
        Console(highlight=False).print(table)
    return 0 if summary["passed"] else 1
