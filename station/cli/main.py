"""The command line of `python -m station`; the program `ctr-station` adds the command `serve` to it."""

import argparse
import errno
import io
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console

from core.errors import CtrError
from station.cli import (
    bench,
    calibrate,
    cameras,
    check_driver,
    config_reference,
    design,
    export,
    ik,
    report,
    run,
    sweep,
    validate,
    workspace,
)
from station.cli.compile_notice import noticed_compilation
from station.cli.options import move_command_first, number_between
from station.config.strict import preset_names
from station.threads import limit_to_one_thread

#: Error numbers of the operating system for a path that cannot be accessed, which any command may cause.
PATH_ERRORS = (errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES)
#: Largest number of characters of an inaccessible path in an error message; a longer path is cut.
MAX_PATH_CHARS = 200


class CommandParser(argparse.ArgumentParser):
    """Argument parser that reports an error in one line. Every command has the option `--data`."""

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self.in_any_order = False
        self.add_argument(
            "--data", type=Path, metavar="DIR", help="data folder: runs, calibrations and log (default: runs)"
        )

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:  # pyright: ignore  - its overloads
        """Parse the arguments; with `in_any_order` options may also be between positional arguments."""
        if not self.in_any_order:
            return super().parse_known_args(args, namespace)
        self.in_any_order = False  # argparse calls this method again for the options, then for the positionals
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self.in_any_order = True

    def error(self, message: str) -> NoReturn:
        """Print the error in one line and exit with status 2."""
        self.exit(2, f"{self.prog}: {' '.join(message.split())}; see {self.prog} --help\n")


def parser() -> tuple[CommandParser, "argparse._SubParsersAction[CommandParser]"]:
    """Return the parser and its commands; `web` adds commands to them."""
    top = CommandParser(
        prog="ctr-station",
        description="Lab station for externally loaded concentric-tube robots.",
        epilog=f"experiments: {', '.join(preset_names('experiments'))}",
    )
    commands = top.add_subparsers(title="commands", metavar="COMMAND")

    run.add(commands)

    solve = commands.add_parser(
        "solve", help="solve the loaded model: JSON lines in, JSON lines out",
        epilog='A line is {"joints": {NAME: value, ...}, "force": [x, y, z], "moment": [x, y, z], "follow": true} [rad,'
        " m, N, N m]; only joints is required. Every line is solved from rest (aligned, unloaded tubes); with follow,"
        " from the shape of the line before, as if the robot moved between them. The tip is the end of the innermost"
        ' tube. With "contact": s the force acts at the arc length s from the plate [m]. "loads": [{"at": s, "force":'
        ' [x, y, z]}], "gravity": [x, y, z] (direction of the tubes\' weight) and "distributed": [x, y, z] [N/m] add'
        " loads; the exact rod solves such a line. The answer has warnings where a joint is beyond its travel, or a"
        " tube is strained beyond what its material recovers from.",
    )  # fmt: skip
    solve.add_argument("--robot", default="paper", metavar="FILE", help="robot: preset or .toml file (default: paper)")
    solve.add_argument(
        "--sublink",
        type=number_between(0.0001, 0.1, "a length", "m"),
        metavar="M",
        help="sub-link length [m] (default: from the robot; 0.01 for the integrator 'paper')",
    )
    solve.add_argument(
        "--integrator", choices=("paper", "fourth_order"), help="integrator of the model (default: from the robot)"
    )
    solve.add_argument("--exact", action="store_true", help="use the exact rod instead of the fast model")
    solve.set_defaults(command=_solve)

    lab = commands.add_parser(
        "lab", help="run only the simulated devices, for drivers to connect to, until interrupted"
    )
    lab.add_argument("--pty", action="store_true", help="serial lines as pseudo-terminals instead of TCP")
    lab.add_argument("--config", type=Path, metavar="FILE", help="station configuration, a .toml file")
    lab.add_argument(
        "--load",
        type=number_between(0.0, 2.0, "a weight", "N"),
        default=0.0,
        metavar="N",
        help="weight at the tip [N] (default: 0)",
    )
    lab.set_defaults(command=_lab)

    bench.add(commands)
    calibrate.add(commands)
    cameras.add(commands)
    check_driver.add(commands)
    design.add(commands)
    export.add(commands)
    config_reference.add(commands)
    report.add(commands)
    sweep.add(commands)
    validate.add(commands)
    workspace.add(commands)
    ik.add(commands)

    doctor = commands.add_parser("doctor", help="check this computer and explain the findings")
    doctor.add_argument(
        "--print",
        choices=("rules", "limits", "service", "dockerfile"),
        help="print a file for the setup of a bench computer",
    )
    doctor.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="station file; connects its stages without moving them, and prints their latency and settings",
    )
    doctor.set_defaults(command=_doctor)
    return top, commands


#: Time after which a lost Ctrl-C is repeated [s]: the destructor that has lost it has ended then.
REPEAT_INTERRUPT_S = 0.1


def _repeat_lost_interrupt(lost: "sys.UnraisableHookArgs") -> None:
    """Repeat a Ctrl-C that Python has ignored, because its exception was raised inside a destructor."""
    if lost.exc_type is KeyboardInterrupt:
        main = threading.main_thread().ident or 0  # the signal must reach this thread, to end its system call, too
        threading.Timer(REPEAT_INTERRUPT_S, signal.pthread_kill, [main, signal.SIGINT]).start()
    else:
        sys.__unraisablehook__(lost)


def execute(top: CommandParser, commands: Container[str], arguments: Sequence[str] | None, meant: str = "") -> int:
    """Run a command (`meant` when none is named) and return its exit status.

    Exit status: 0 done, 1 not completed, 2 bad input, 130 interrupted.
    """
    given = sys.argv[1:] if arguments is None else arguments
    parsed = top.parse_args(move_command_first(given, commands, meant))
    if not hasattr(parsed, "command"):
        top.print_help()
        return 2
    command: Callable[[argparse.Namespace], int] = parsed.command
    limit_to_one_thread()
    sys.unraisablehook = _repeat_lost_interrupt
    try:
        with noticed_compilation():
            return command(parsed)
    except CtrError as error:
        # Print one line, even if the error text contains line breaks.
        sys.stderr.write(f"ctr-station: {' '.join(str(error).split())}\n")
        return 2
    except KeyboardInterrupt:
        return _interrupted()
    except SystemError as error:
        # Ctrl-C inside compiled code raises this error instead of KeyboardInterrupt, sometimes several times in a row.
        if _caused_by_interrupt(error):
            return _interrupted()
        raise
    except BrokenPipeError:
        # The program that reads the output has ended. Redirect the output: its buffer would raise again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        if error.errno not in PATH_ERRORS:
            raise
        sys.stderr.write(f"ctr-station: {' '.join(str(error.filename).split())[:MAX_PATH_CHARS]}: {error.strerror}\n")
        return 2


def _caused_by_interrupt(error: BaseException) -> bool:
    """Return whether a KeyboardInterrupt is among the causes of an error."""
    checked, errors = set[int](), [error]
    while errors:
        one = errors.pop()
        if isinstance(one, KeyboardInterrupt):
            return True
        checked.add(id(one))
        errors += [each for each in (one.__cause__, one.__context__) if each is not None and id(each) not in checked]
    return False


def _interrupted() -> int:
    sys.stderr.write("ctr-station: interrupted\n")
    return 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `python -m station`."""
    top, commands = parser()
    return execute(top, commands.choices, arguments)


def _solve(parsed: argparse.Namespace) -> int:
    from station.config.robots import load_robot  # imported here: compiled code is half of the start time
    from station.service.solve import batched_lines, solve_lines

    file = load_robot(parsed.robot)
    lines = sys.stdin or io.StringIO()  # stdin is None if the shell has closed it
    # Read bytes, so that invalid UTF-8 affects only its line.
    batches = batched_lines(lines.buffer) if isinstance(lines, io.TextIOWrapper) else ([line] for line in lines)
    limits = file.limits().joints
    for answer in solve_lines(batches, file.robot(), parsed.sublink, parsed.integrator, parsed.exact, limits):
        print(answer, flush=True)  # noqa: T201
    return 0


def _lab(parsed: argparse.Namespace) -> int:
    import numpy as np

    from station.config.loads import ConstantLoad
    from station.lab.lab_server import LabServer, serve
    from station.service.station_file import load_station

    bench = load_station(parsed.config).bench()
    lab = LabServer(bench.robot, bench.lab, bench.seed, np.array(bench.park), pty=parsed.pty)
    load = ConstantLoad(magnitude=parsed.load)
    serve(lab, load, lambda where: print(json.dumps(where), flush=True), bench.fifo)  # noqa: T201
    return 0


def _doctor(parsed: argparse.Namespace) -> int:
    if parsed.print:
        from station.cli.machine import machine_file

        print(machine_file(parsed.print), end="")  # noqa: T201
        return 0
    from station.cli.doctor import findings

    console = Console(highlight=False, soft_wrap=True)
    for finding in findings(parsed.config):
        mark = "[green]ok  [/]" if finding.good else "[yellow]WARN[/]"
        console.print(f"{mark} [bold]{finding.subject}[/]: ", end="")
        console.print(finding.text, markup=False)
    return 0
