"""The command `ctr-station`: the subcommand `serve`, and all commands of `python -m station`."""

import argparse
import errno
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from station.cli.main import execute, parser
from station.cli.options import add_without, data_folder, seed
from station.control.realtime import uncollected
from web.gateway.options import FOXGLOVE_PORT, IGTL_PORT, ZENOH_PORT, GatewayOptions, ListenAddress, address_of

#: Signals that end the station in an orderly way; SIGHUP comes when its terminal is closed, SIGQUIT from Ctrl-\\.
EXIT_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
#: Signals that would suspend the station: Ctrl-Z, and use of the terminal by a program in the background.
SUSPENDING_SIGNALS = (signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)
NOT_SUSPENDED = b"\nctr-station cannot be suspended, because it could then take no STOP; Ctrl-C ends it.\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command `ctr-station`; without a subcommand it runs `serve`."""
    top, commands = parser()
    serve = commands.add_parser(
        "serve", help="start the station: control process and page, by default with a virtual lab (default command)"
    )
    serve.add_argument("--config", type=Path, metavar="FILE", help="station configuration, a .toml file")
    serve.add_argument(
        "--lab", metavar="LAB", help="virtual lab: gentle, realistic, ..., or .toml file (default: gentle)"
    )
    add_without(serve)
    serve.add_argument("--robot", metavar="ROBOT", help="robot: preset or .toml file (default: paper)")
    serve.add_argument(
        "--seed", type=seed, metavar="N", help="seed of all random numbers of the virtual lab (default: 0)"
    )
    serve.add_argument("--calibration", type=Path, metavar="DIR", help="folder with the results of 'calibrate'")
    serve.add_argument("--host", default="127.0.0.1", metavar="H", help="address to listen on (default: 127.0.0.1)")
    serve.add_argument("--port", type=_port, default=8000, metavar="P", help="port of page and REST (default: 8000)")
    serve.add_argument("--no-browser", action="store_true", help="do not open a browser")
    for name, port, what in (
        ("igtl", IGTL_PORT, "OpenIGTLink (3D Slicer, PLUS)"),
        ("foxglove", FOXGLOVE_PORT, "Foxglove, live"),
        ("ros2", ZENOH_PORT, "ROS 2 over Zenoh"),
    ):
        text = f"also serve {what}; on loopback unless HOST is given (default port: {port})"
        serve.add_argument(
            f"--{name}", type=_address, nargs="?", const=address_of(str(port)), metavar="[HOST:]PORT", help=text
        )
    serve.add_argument(
        "--ros2-namespace", type=_namespace, default="CTR", metavar="NAME",
        help="namespace of the robot's topics in ROS 2 (default: CTR)",
    )  # fmt: skip
    serve.add_argument(
        "--lsl", action="store_true", help="also serve Lab Streaming Layer (LabRecorder), on this computer"
    )
    serve.set_defaults(command=_serve)
    sys.exit(execute(top, commands.choices, arguments, "serve"))


def _serve(parsed: argparse.Namespace) -> int:
    known = None if parsed.calibration is None else str(parsed.calibration.absolute())
    given = {
        "robot": parsed.robot,
        "lab": parsed.lab,
        "seed": parsed.seed,
        "calibration": known,
        "without": parsed.without or None,
    }
    changes = {key: value for key, value in given.items() if value is not None}
    options = GatewayOptions(parsed.igtl, parsed.foxglove, parsed.lsl, parsed.ros2, parsed.ros2_namespace)
    # Almost all objects of the start stay in use, so a garbage collection would free little and take a fifth of the
    # processor time. The web server enables the collection again when it starts.
    with exit_on_signal() as interrupted, uncollected():
        from web.serve import serve

        browser = not parsed.no_browser
        return serve(
            parsed.config, changes, parsed.host, parsed.port, data_folder(parsed), options, interrupted, browser=browser
        )


def _namespace(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", text):
        raise argparse.ArgumentTypeError(f"{text!r} is no namespace: use letters, digits and _, a letter first")
    return text


def _port(text: str) -> int:
    value = int(text)
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"port {text} is outside 0 ... 65535")
    return value


def _address(text: str) -> ListenAddress:
    try:
        return address_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: {error}") from None


def without_closed_terminal() -> None:
    """Discard further output to a terminal that was closed: writing to it would raise an error during the cleanup."""
    for stream in (0, 1, 2):
        try:
            os.tcgetpgrp(stream)  # only a terminal that still exists has a foreground process group
        except OSError as error:
            if error.errno == errno.EIO:
                nothing = os.open(os.devnull, os.O_RDWR)
                os.dup2(nothing, stream)
                os.close(nothing)


@contextmanager
def exit_on_signal() -> Iterator[Callable[[], bool]]:
    """Raise KeyboardInterrupt at the first signal; ignore further signals during the cleanup that follows.

    Signals that would suspend the station are refused with a sentence. SIGHUP stays ignored under `nohup`.

    The context's value is a function that returns whether a signal has arrived. A loop that waits for the end calls it
    as well, because Python drops the exception if the signal arrives during a finalizer.
    """
    received: list[int] = []

    def on_signal(number: int, _frame: FrameType | None) -> None:
        received.append(number)
        without_closed_terminal()
        for ending in EXIT_SIGNALS:
            signal.signal(ending, signal.SIG_IGN)  # the signals stay ignored while the interpreter ends
        raise KeyboardInterrupt

    def refuse(_number: int, _frame: FrameType | None) -> None:
        with suppress(OSError):
            os.write(2, NOT_SUSPENDED)

    ending = [number for number in EXIT_SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, on_signal) for number in ending}
    before |= {number: signal.signal(number, refuse) for number in SUSPENDING_SIGNALS}
    try:
        yield lambda: bool(received)
    finally:
        if not received:
            for number, handler in before.items():
                signal.signal(number, handler)
