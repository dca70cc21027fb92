"""The command `check-driver`: check whether a device's driver keeps the contract that the control loop relies on."""

import argparse
import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console


def add(commands: "argparse._SubParsersAction[Any]") -> None:
    """Add the command `check-driver` to the parser."""
    check = commands.add_parser(
        "check-driver", help="check whether a driver keeps the contract of the control loop",
        description="Check the built-in driver NAME on simulated devices, or with --config every driver that a station"
        " file names, on its devices. Each line names a requirement and starts with ok, FAIL or -- (not checked). The"
        " exit status is 1 after a FAIL.",
    )  # fmt: skip
    check.add_argument(
        "name", nargs="?", metavar="NAME", help="zaber, zaber_ascii, cia402, grbl, marlin, aurora or netft"
    )
    check.add_argument("--config", type=Path, metavar="FILE", help="station configuration, a .toml file with [devices]")
    check.add_argument(
        "--move", action="store_true",
        help="with --config: also home and move the stages; first make sure that they can move freely",
    )  # fmt: skip
    check.add_argument(
        "--requirements", action="store_true", help="print the requirements as a table, and check nothing"
    )
    check.set_defaults(command=_check)


def _check(parsed: argparse.Namespace) -> int:
    from station.config.strict import ConfigError
    from station.devices.config import BenchFile
    from station.devices.driver_check.requirements import requirements_table
    from station.service.station_file import load_station

    if parsed.requirements:
        print(requirements_table(), end="")  # noqa: T201
        return 0
    if (parsed.name is None) == (parsed.config is None):
        raise ConfigError("give either the name of a built-in driver, or a station file with --config")
    if parsed.config is not None:
        file = load_station(parsed.config)
        if not isinstance(file.devices, BenchFile):
            raise ConfigError(f"{parsed.config}: it has no [devices]; to check a built-in driver, give its name")
        return _report(file.devices, file.bench().robot, parsed.move)
    with _simulated(parsed.name) as (devices, robot, kind):
        return _report(devices, robot, True, kind)


@contextlib.contextmanager
def _simulated(name: str) -> Iterator[tuple[Any, Any, str]]:
    """Run a virtual lab with the devices of a driver; yield the bench, the robot, and the kind of the device."""
    import numpy as np

    from station.config.robots import load_robot
    from station.config.strict import ConfigError
    from station.control.clock import StationClock
    from station.lab.config import load_lab
    from station.lab.lab_server import LabServer, devices_at
    from station.lab.simulated_stages import STAGES

    kind = "stages" if name in STAGES else {"aurora": "tracker", "netft": "sensors"}.get(name)
    if kind is None:
        raise ConfigError(f"no simulated device has the driver '{name}'; check it on its device with --config FILE")
    robot, clock = load_robot("paper"), StationClock(patience=1.0)
    config = load_lab("gentle", robot)
    if kind == "stages":
        config = config.model_copy(update={"stages": name})
    with LabServer(robot, config, 0, np.array([0.05, 0.3, -0.125]), clock=clock) as lab:
        lab.lab.advance(0.0)  # compiles the code before the devices must answer in time
        over = threading.Event()
        thread = threading.Thread(target=lab.run, args=(over.is_set,))
        thread.start()
        try:
            bench = devices_at(lab.endpoints, config, clock)
            yield bench, robot, kind
        finally:
            over.set()
            thread.join()


def _report(bench: Any, robot: Any, moves: bool, only: str = "") -> int:
    """Check the drivers of a bench, or `only` that of one kind; print the findings, and return the exit status."""
    from station.control.clock import REAL_TIME_CLOCK
    from station.devices.driver_check.samples import check_sensors, check_tracker
    from station.devices.driver_check.stages import check_stages
    from station.devices.registry import emergency_stop, plan

    openers = plan(bench, robot)
    checks = {
        "stages": lambda opens: check_stages(
            opens, robot.joints, REAL_TIME_CLOCK, emergency_stop(bench.stages, robot), moves
        ),
        "tracker": lambda opens: check_tracker(opens, REAL_TIME_CLOCK),
        "sensors": lambda opens: check_sensors(opens, len(robot.sensor_names), REAL_TIME_CLOCK),
    }
    console, failed = Console(highlight=False, soft_wrap=True), 0
    marks = {True: "[green]ok  [/]", False: "[red]FAIL[/]", None: "--  "}
    for kind, opens in openers.items():
        if only not in ("", kind):
            continue
        console.print(f"[bold]{kind}[/]: driver {getattr(bench, kind)['driver']}")
        for finding in checks[kind](opens):
            failed += finding.good is False
            console.print(marks[finding.good], end=" ")
            console.print(f"{finding.subject}: {finding.text}", markup=False)
    return 1 if failed else 0
