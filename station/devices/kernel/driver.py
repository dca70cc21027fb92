"""The functions that each built-in driver of stages provides; they depend on the driver's options and on the robot."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

from station.config.controllers import StagesLatency
from station.config.robots import RobotFile
from station.config.strict import check
from station.devices.interfaces import Clock, EmergencyStop, Stages
from station.devices.kernel.axis import STAGES_KEY, CountedJoint
from station.devices.kernel.stages import Port, one_port
from station.devices.links.link import Link, SerialLink, lock_file

T = TypeVar("T")
#: Function of the table `[devices.stages]` and of the robot; it raises ConfigError for an invalid table.
OfOptions = Callable[[Mapping[str, Any], RobotFile], T]


class StagesDriver(NamedTuple):
    """A driver of stages; the entry point of an installed driver may name one, too."""

    open: OfOptions[Callable[[], Stages]]  #: checks the options, and returns the opener of the stages
    latency: OfOptions[StagesLatency]
    emergency_stop: OfOptions[EmergencyStop]
    on_link: Callable[[Mapping[str, Any], RobotFile, Link], Stages]  #: returns the stages behind an open link

    def __call__(self, options: Mapping[str, Any], robot: RobotFile) -> Stages:
        """Open the stages and return them."""
        return self.open(options, robot)()


File = TypeVar("File")
Setup = TypeVar("Setup", bound=CountedJoint)
#: Function that returns the indices of the joints on each port.
Lines = Callable[[Sequence[Setup], File], Mapping[str, Sequence[int]]]


def on_the_port(setups: Sequence[CountedJoint], file: Any) -> Mapping[str, Sequence[int]]:
    """Return the indices of all joints, which are on the only port of the options."""
    return {file.port: range(len(setups))}


def on_ports(
    options: type[File],
    setups: Callable[[File, RobotFile], Sequence[Setup]],
    baud: Callable[[File], int],
    stages: Callable[[Sequence[Setup], Sequence[Port], File], Stages],
    latency: Callable[[Sequence[Setup], File], StagesLatency],
    stop: Callable[[Sequence[Setup], File, Clock], str],
    lines: Lines[Setup, File] = on_the_port,
) -> StagesDriver:
    """Return a driver of stages on serial ports.

    Args:
        options: class that describes the table `[devices.stages]`.
        setups: returns the setup of each joint; may raise ConfigError.
        baud: returns the baud rate of the ports [bit/s].
        stages: returns the stages on open ports.
        latency: returns the latency of the stages.
        stop: stops the stages after a crash of the control process (`EmergencyStop`).
        lines: returns the indices of the joints on each port; may raise ConfigError.
    """

    def checked(table: Mapping[str, Any], robot: RobotFile) -> tuple[Sequence[Setup], File]:
        model: Any = options
        file: File = check(model, table, STAGES_KEY)
        return setups(file, robot), file

    def opener(table: Mapping[str, Any], robot: RobotFile) -> Callable[[], Stages]:
        axes, file = checked(table, robot)
        joints = lines(axes, file)

        def open_ports() -> Stages:
            with contextlib.ExitStack() as opened:
                ports: list[Port] = []
                for url, indices in joints.items():
                    link = SerialLink(url, baud(file))
                    opened.callback(link.close)
                    ports.append(Port(link, tuple(indices)))
                found = stages(axes, ports, file)
                opened.pop_all()
                return found

        return open_ports

    def on_link(table: Mapping[str, Any], robot: RobotFile, link: Link) -> Stages:
        axes, file = checked(table, robot)
        return stages(axes, one_port(link, axes), file)

    def emergency_stop(table: Mapping[str, Any], robot: RobotFile) -> EmergencyStop:
        axes, file = checked(table, robot)
        for port in lines(axes, file):
            lock_file(port)  # finds the folder for temporary files now, because the search writes a test file there
        return partial(stop, axes, file)

    return StagesDriver(opener, lambda table, robot: latency(*checked(table, robot)), emergency_stop, on_link)
