"""Shared parts of the commands: option types, the progress bar, and the output of results."""

import argparse
import json
import sys
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from station.jobs.dask_cluster import has_dask
from station.jobs.processes import processors

if TYPE_CHECKING:
    from station.jobs.run_jobs import Workers

#: Options without a value that may precede a command; every other option is followed by its value.
SERVE_FLAGS = ("--no-browser", "--json")
HELP_FLAGS = ("-h", "--help")


def move_command_first(arguments: Sequence[str], commands: Container[str], meant: str = "") -> list[str]:
    """Return the arguments with the command first, so that its parser reads all of them or rejects unknown ones.

    Args:
        arguments: arguments of the command line, in their original order.
        commands: names of all commands.
        meant: default command if no command is named; empty if there is no default.
    """
    before = ""
    for number, argument in enumerate(arguments):
        is_value = before.startswith("--") and "=" not in before and before not in SERVE_FLAGS
        if argument in commands and not is_value:
            return [argument, *arguments[:number], *arguments[number + 1 :]]
        if argument in HELP_FLAGS:
            break
        before = argument
    else:
        if meant:
            return [meant, *arguments]
    return list(arguments)


def add_without(command: argparse.ArgumentParser) -> None:
    """Add the option `--without` to a command that drives a virtual lab."""
    command.add_argument(
        "--without", action="append", choices=("tracker", "sensors"),
        help="leave this device of the virtual lab out; may be repeated",
    )  # fmt: skip


def add_workers(command: argparse.ArgumentParser) -> None:
    """Add the options `--jobs` and `--scheduler` to a command that carries out jobs in parallel."""
    command.add_argument(
        "--jobs", type=count(1024), default=processors(), metavar="N", help="processes (default: one per processor)"
    )
    command.add_argument(
        "--scheduler", type=_scheduler, metavar="ADDRESS",
        help="use the Dask cluster at tcp://HOST:PORT; 'local': start a cluster on this computer",
    )  # fmt: skip


def _scheduler(text: str) -> str:
    if not has_dask():
        raise argparse.ArgumentTypeError("needs the package distributed: pip install 'ctr-station[dask]'")
    return text


def started_workers(parsed: argparse.Namespace, jobs: int, bar: Progress) -> "AbstractContextManager[Workers]":
    """Start the workers that `--jobs` and `--scheduler` request, at most `jobs`; print a line above the progress bar.

    Raises:
        DaskError: no scheduler answers.
    """
    from station.jobs.run_jobs import start_workers

    report = partial(bar.console.print, markup=False, soft_wrap=True)
    return start_workers(min(parsed.jobs, jobs), parsed.scheduler, report)


def progress_bar(over: float = 30.0) -> Progress:
    """Return a progress bar for terminals; it estimates the remaining time from the pace of the last `over` [s]."""
    console = Console(stderr=True, highlight=False)
    return Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(), console=console, disable=not console.is_terminal, speed_estimate_period=over,
    )  # fmt: skip


def number_between(lower: float, upper: float, what: str, unit: str) -> Callable[[str], float]:
    """Return a parser for an option's number from `lower` to `upper`; its errors state the expected value."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not {what}, {lower:g} ... {upper:g} {unit}") from None
        if not lower <= value <= upper:
            raise argparse.ArgumentTypeError(f"{text} {unit} is outside {lower:g} ... {upper:g} {unit}")
        return value

    return read


def seed(text: str) -> int:
    """Parse the seed of a random number generator, a whole number."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, 0 ... 2^63 - 1") from None
    if not 0 <= value < 2**63:
        raise argparse.ArgumentTypeError(f"{text} is outside 0 ... 2^63 - 1")
    return value


def count(maximum: int) -> Callable[[str], int]:
    """Return a parser for an option's whole number from 1 to `maximum`."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, 1 ... {maximum}") from None
        if not 1 <= value <= maximum:
            raise argparse.ArgumentTypeError(f"{text} is outside 1 ... {maximum}")
        return value

    return read


def data_folder(parsed: argparse.Namespace) -> Path:
    """Return the folder of runs, calibrations and log."""
    return Path("runs") if parsed.data is None else parsed.data


def recovered_data(parsed: argparse.Namespace) -> Path:
    """Finish interrupted runs in the data folder, print those that cannot be finished, and return the folder."""
    from station.recording.recover import recover

    runs = data_folder(parsed)
    for sentence in recover(runs).problems:
        sys.stderr.write(f"ctr-station: {sentence}\n")
    return runs


def result_folder(parsed: argparse.Namespace, name: str) -> Path:
    """Return the folder of results: `--out` if given, else `name` inside the data folder or the current folder."""
    return parsed.out or (Path(name) if parsed.data is None else parsed.data / name)


def command_line_path(value: Path | str) -> str:
    """Return the absolute path of a command-line argument; an experiment resolves paths relative to its own file."""
    return str(Path(value).absolute()) if isinstance(value, Path) or value.endswith(".toml") else value


def add_results(command: argparse.ArgumentParser, folder: str) -> None:
    """Add the options `--out` (default: `result_folder(parsed, folder)`) and `--json` to a command with results."""
    command.add_argument(
        "--out", type=Path, metavar="DIR", help=f"folder of results (default: {folder}, inside --data if given)"
    )
    command.add_argument("--json", action="store_true", help="print one JSON object instead of tables")


def print_result(
    parsed: argparse.Namespace,
    numbers: Mapping[str, Any],
    tables: Iterable[Table],
    sentences: Iterable[str],
    folder: Path,
) -> int:
    """Print the result of a command, with `--json` its numbers and folder as one JSON object; return 0."""
    if parsed.json:
        sys.stdout.write(f"{json.dumps({**numbers, 'folder': str(folder)})}\n")
        return 0
    out = Console(highlight=False, markup=False)
    for table in tables:
        out.print(table)
    for sentence in (*sentences, str(folder)):
        out.print(sentence, soft_wrap=True)
    return 0
