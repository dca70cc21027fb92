"""The commands `report`, `figure`, `replay` and `curves`: evaluate a recorded run and write the result to files."""

import argparse
import sys
from pathlib import Path
from typing import Any


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the commands `report`, `figure`, `replay` and `curves` to the parser."""
    run = "folder of a run or sweep, its name in the data folder, or 'latest'"
    report = commands.add_parser("report", help="write figures and tables of a run as one HTML file")
    report.add_argument("run", metavar="RUN", help=run)
    report.add_argument("--out", type=Path, metavar="DIR", help="folder for report.html and PNG and PDF of each figure")
    report.set_defaults(command=_report)

    figure = commands.add_parser(
        "figure",
        help="write tip error and force of several cases or runs as one figure, for a journal's column of 88 mm",
    )
    figure.add_argument("runs", nargs="+", metavar="RUN[:CASE]", help=f"{run}; without CASE all its cases")
    figure.add_argument("-o", "--out", type=Path, required=True, metavar="FILE", help="output file, .pdf or .svg")
    figure.set_defaults(command=_figure)

    replay = commands.add_parser("replay", help="write a run as an HTML file that plays it in three dimensions")
    replay.add_argument("run", metavar="RUN", help=run)
    replay.add_argument("--out", type=Path, metavar="FILE", help="file (default: replay.html in the run's folder)")
    replay.set_defaults(command=_replay)

    curves = commands.add_parser("curves", help="write error and force of a run as a few hundred numbers, curves.json")
    curves.add_argument("run", metavar="RUN", help=run)
    curves.set_defaults(command=_curves)


def _report(parsed: argparse.Namespace) -> int:
    from station.report.page import write_report

    sys.stdout.write(f"{write_report(_folder(parsed), parsed.out)}\n")
    return 0


def _figure(parsed: argparse.Namespace) -> int:
    from station.cli.options import recovered_data
    from station.recording.history import resolve_run
    from station.report.overlay import write_overlay

    data, chosen = recovered_data(parsed), list[tuple[Path, str]]()
    for name in parsed.runs:
        run, _, case = (name, "", "") if ":" not in name or Path(name).is_dir() else name.rpartition(":")
        chosen.append((resolve_run(run, data), case))
    sys.stdout.write(f"{write_overlay(chosen, parsed.out)}\n{parsed.out}\n")
    return 0


def _replay(parsed: argparse.Namespace) -> int:
    from station.cli.options import progress_bar
    from station.report.player import write_player

    folder = _folder(parsed)
    with progress_bar() as bar:
        task = bar.add_task(f"replay {folder.name}", total=1.0)
        path = write_player(folder, parsed.out, lambda done: bar.update(task, completed=done))
    sys.stdout.write(f"{path}\n")
    return 0


def _curves(parsed: argparse.Namespace) -> int:
    from station.report.curves import write_curves

    sys.stdout.write(f"{write_curves(_folder(parsed))}\n")
    return 0


def _folder(parsed: argparse.Namespace) -> Path:
    from station.cli.options import recovered_data
    from station.recording.history import resolve_run

    return resolve_run(parsed.run, recovered_data(parsed))
