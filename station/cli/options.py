"""What commands share: how options are read, the progress bar, and how a result is told."""

import argparse
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table


def progress_bar(over: float = 30.0) -> Progress:
    """A progress bar on a terminal, nothing elsewhere; the time left is told from the pace of the last `over` [s]."""
    console = Console(stderr=True, highlight=False)
    return Progress(
        TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(), console=console, disable=not console.is_terminal, speed_estimate_period=over,
    )  # fmt: skip


def between(lower: float, upper: float, what: str, unit: str) -> Callable[[str], float]:
    """Reads an option's number and says what it should have been."""

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
    """Reads a seed."""
    try:
        value = int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, 0 ... 2^63 - 1") from None
    if not 0 <= value < 2**63:
        raise argparse.ArgumentTypeError(f"{text} is outside 0 ... 2^63 - 1")
    return value


def count(most: int) -> Callable[[str], int]:
    """Reads an option's whole number, from 1 on."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, 1 ... {most}") from None
        if not 1 <= value <= most:
            raise argparse.ArgumentTypeError(f"{text} is outside 1 ... {most}")
        return value

    return read


def data_of(parsed: argparse.Namespace) -> Path:
    """Folder of runs, calibrations and log."""
    return Path("runs") if parsed.data is None else parsed.data


def recovered(parsed: argparse.Namespace) -> Path:
    """The same, once the runs in it that were cut off are finished; those that cannot be are told."""
    from station.recording.recover import left_alone, recover

    runs = data_of(parsed)
    recover(runs)
    for sentence in left_alone(runs):
        sys.stderr.write(f"ctr-station: {sentence}\n")
    return runs


def results_of(parsed: argparse.Namespace, name: str) -> Path:
    """Where results of this name go: as told, else in the folder of data, if one was given, else here."""
    return parsed.out or (Path(name) if parsed.data is None else parsed.data / name)


def from_here(value: Path | str) -> str:
    """A file or folder given on the command line, which an experiment would look for beside itself."""
    return str(Path(value).absolute()) if isinstance(value, Path) or value.endswith(".toml") else value


def tell(tables: Iterable[Table], sentences: Iterable[str], folder: Path) -> None:
    """Print a result: its tables, its sentences and where all of it is kept."""
    out = Console(highlight=False, markup=False)
    for table in tables:
        out.print(table)
    for sentence in (*sentences, str(folder)):
        out.print(sentence, soft_wrap=True)
