"""Shared parts of the commands: option types, the progress bar, and the output of results."""

import argparse
import sys
from collections.abc import Callable, Container, Iterable, Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

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
    from station.recording.recover import recover, unrecoverable

    runs = data_folder(parsed)
    recover(runs)
    for sentence in unrecoverable(runs):
        sys.stderr.write(f"ctr-station: {sentence}\n")
    return runs


def result_folder(parsed: argparse.Namespace, name: str) -> Path:
    """Return the folder of results: `--out` if given, else `name` inside the data folder or the current folder."""
    return parsed.out or (Path(name) if parsed.data is None else parsed.data / name)


def command_line_path(value: Path | str) -> str:
    """Return the absolute path of a command-line argument; an experiment resolves paths relative to its own file."""
    return str(Path(value).absolute()) if isinstance(value, Path) or value.endswith(".toml") else value


def print_result(tables: Iterable[Table], sentences: Iterable[str], folder: Path) -> None:
    """Print the result of a command: its tables, its sentences and its folder."""
    out = Console(highlight=False, markup=False)
    for table in tables:
        out.print(table)
    for sentence in (*sentences, str(folder)):
        out.print(sentence, soft_wrap=True)
