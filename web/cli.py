"""The command `ctr-station`: `serve`, and all that `python -m station` has."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from station.cli.main import execute, parser
from station.cli.options import data_of, seed
from station.service.signals import ended_once
from web.gateway.wanted import FOXGLOVE, IGTL, ZENOH, Address, Wanted, address_of


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point; without a command it serves."""
    top, commands = parser()
    serve = commands.add_parser("serve", help="start the virtual lab, the control process and the panel (default)")
    serve.add_argument("--config", type=Path, metavar="FILE", help="station configuration, a .toml file")
    serve.add_argument("--lab", metavar="LAB", help="virtual lab: gentle, realistic, ..., or .toml file (gentle)")
    serve.add_argument("--seed", type=seed, metavar="N", help="of everything random in the virtual lab (0)")
    serve.add_argument("--calibration", type=Path, metavar="DIR", help="use what 'calibrate' found")
    serve.add_argument("--host", default="127.0.0.1", metavar="H", help="address to listen on (127.0.0.1)")
    serve.add_argument("--port", type=_port, default=8000, metavar="P", help="port of page and REST (8000)")
    serve.add_argument("--no-browser", action="store_true", help="do not open a browser")
    for name, port, what in (
        ("igtl", IGTL, "OpenIGTLink (3D Slicer, PLUS)"),
        ("foxglove", FOXGLOVE, "Foxglove, live"),
        ("ros2", ZENOH, "ROS 2 over Zenoh"),
    ):
        said = f"also serve {what}; on loopback unless a host is named ({port})"
        serve.add_argument(
            f"--{name}", type=_address, nargs="?", const=address_of(str(port)), metavar="[HOST:]PORT", help=said
        )
    serve.add_argument(
        "--lsl", action="store_true", help="also serve Lab Streaming Layer (LabRecorder), on this machine"
    )
    serve.set_defaults(command=_serve)
    sys.exit(execute(top, commands.choices, arguments, "serve"))


def _serve(parsed: argparse.Namespace) -> int:
    known = None if parsed.calibration is None else str(parsed.calibration.absolute())
    given = {"lab": parsed.lab, "seed": parsed.seed, "calibration": known}
    changes = {key: value for key, value in given.items() if value is not None}
    wanted = Wanted(parsed.igtl, parsed.foxglove, parsed.lsl, parsed.ros2)
    with ended_once():
        from web.app import serve

        browser = not parsed.no_browser
        return serve(parsed.config, changes, parsed.host, parsed.port, data_of(parsed), wanted, browser=browser)


def _port(text: str) -> int:
    value = int(text)
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"{text} is outside 0 ... 65535")
    return value


def _address(text: str) -> Address:
    try:
        return address_of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text}: {error}") from None
