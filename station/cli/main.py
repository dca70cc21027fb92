"""The command line without a browser: `python -m station`, and `ctr-station` adds `serve`."""

import argparse
import errno
import io
import json
import os
import sys
from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console

from core.errors import CtrError
from station.cli import bench, calibrate, design, export, keys, report, run, soak, sweep, validate, workspace
from station.cli.options import between
from station.cli.placed import command_first
from station.config.strict import preset_names

#: What the system says of a path that cannot even be looked at, wherever it was given.
NO_PATH = (errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES)
#: So much of it is told [characters].
LONGEST = 200


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line; `--help` has the rest. Every command takes the folder of data."""

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self.in_any_order = False
        self.add_argument("--data", type=Path, metavar="DIR", help="folder of runs, calibrations and log (runs)")

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:  # pyright: ignore
        """Options may also stand between a command's words, where those are `in_any_order`."""
        if not self.in_any_order:
            return super().parse_known_args(args, namespace)
        self.in_any_order = False  # argparse comes back here for the options alone, then for the words alone
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self.in_any_order = True

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f"{self.prog}: {' '.join(message.split())}; see {self.prog} --help\n")


def parser() -> tuple[Parser, "argparse._SubParsersAction[Parser]"]:
    """The parser and its commands, for `web` to add its own."""
    top = Parser(
        prog="ctr-station",
        description="Lab station for externally loaded concentric-tube robots.",
        epilog=f"experiments: {', '.join(preset_names('experiments'))}",
    )
    commands = top.add_subparsers(title="commands", metavar="COMMAND")

    run.add(commands)

    solve = commands.add_parser("solve", help="the loaded model: JSON lines in, JSON lines out")
    solve.add_argument("--robot", default="paper", metavar="FILE", help="preset or .toml file (paper)")
    solve.add_argument(
        "--sublink",
        type=between(0.0001, 0.1, "a length", "m"),
        metavar="M",
        help="sub-link length [m] (0.01)",
    )
    solve.add_argument("--exact", action="store_true", help="the exact rod instead of the paper's model; tip only")
    solve.set_defaults(command=_solve)

    lab = commands.add_parser("lab", help="only the simulated devices, for drivers to connect to, until interrupted")
    lab.add_argument("--pty", action="store_true", help="serial lines as pseudo-terminals instead of TCP")
    lab.add_argument("--config", type=Path, metavar="FILE", help="station configuration, a .toml file")
    lab.add_argument(
        "--load", type=between(0.0, 2.0, "a weight", "N"), default=0.0, metavar="N", help="weight at the tip [N] (0)"
    )
    lab.set_defaults(command=_lab)

    bench.add(commands)
    calibrate.add(commands)
    design.add(commands)
    export.add(commands)
    keys.add(commands)
    report.add(commands)
    sweep.add(commands)
    soak.add(commands)
    validate.add(commands)
    workspace.add(commands)

    doctor = commands.add_parser("doctor", help="what this machine offers, in plain words")
    doctor.add_argument(
        "--print", choices=("rules", "limits", "service", "dockerfile"), help="a file that a bench's computer needs"
    )
    doctor.set_defaults(command=_doctor)
    return top, commands


def execute(top: Parser, commands: Container[str], arguments: Sequence[str] | None, meant: str = "") -> int:
    """Parse and run, the command `meant` when none is named; 0 done, 1 not completed, 2 bad input, 130 interrupted."""
    given = sys.argv[1:] if arguments is None else arguments
    parsed = top.parse_args(command_first(given, commands, meant))
    if not hasattr(parsed, "command"):
        top.print_help()
        return 2
    command: Callable[[argparse.Namespace], int] = parsed.command
    try:
        return command(parsed)
    except CtrError as error:
        # One line, whatever was quoted in it.
        sys.stderr.write(f"ctr-station: {' '.join(str(error).split())}\n")
        return 2
    except KeyboardInterrupt:
        return _interrupted()
    except SystemError as error:
        # Ctrl-C inside compiled code comes out as this.
        if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
            return _interrupted()
        raise
    except BrokenPipeError:
        # Whoever read our output has gone; what is left in the buffer must not fail once more at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        if error.errno not in NO_PATH:
            raise
        sys.stderr.write(f"ctr-station: {' '.join(str(error.filename).split())[:LONGEST]}: {error.strerror}\n")
        return 2


def _interrupted() -> int:
    sys.stderr.write("ctr-station: interrupted\n")
    return 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `python -m station`."""
    top, commands = parser()
    return execute(top, commands.choices, arguments)


def _solve(parsed: argparse.Namespace) -> int:
    from core.model.statics import PAPER_SUBLINK  # here: compiled code is half of what a command takes to start
    from station.config.robots import load_robot
    from station.service.solve import as_they_come, solve_lines

    sublink = PAPER_SUBLINK if parsed.sublink is None else parsed.sublink
    robot = load_robot(parsed.robot).robot()
    lines = sys.stdin or io.StringIO()  # none at all when the shell closed it
    # As bytes: one that is no text spoils its own line only.
    batches = as_they_come(lines.buffer) if isinstance(lines, io.TextIOWrapper) else ([line] for line in lines)
    for answer in solve_lines(batches, robot, sublink, parsed.exact):
        print(answer, flush=True)  # noqa: T201
    return 0


def _lab(parsed: argparse.Namespace) -> int:
    import numpy as np

    from station.lab.lab_server import LabServer, serve
    from station.lab.loads import ConstantLoad
    from station.service.station_file import load_station

    bench = load_station(parsed.config).bench()
    lab = LabServer(bench.robot, bench.lab, bench.seed, np.array(bench.park), pty=parsed.pty)
    serve(lab, ConstantLoad(magnitude=parsed.load), lambda where: print(json.dumps(where), flush=True))  # noqa: T201
    return 0


def _doctor(parsed: argparse.Namespace) -> int:
    if parsed.print:
        from station.cli.machine import printed

        print(printed(parsed.print), end="")  # noqa: T201
        return 0
    from station.cli.doctor import findings

    console = Console(highlight=False, soft_wrap=True)
    for finding in findings():
        mark = "[green]ok  [/]" if finding.good else "[yellow]WARN[/]"
        console.print(f"{mark} [bold]{finding.subject}[/]: ", end="")
        console.print(finding.text, markup=False)
    return 0
