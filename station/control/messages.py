"""What the station process and the control process say to each other through their pipe."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from core.robot.robot import Array
from station.control.jog import Space
from station.control.states import Event, State
from station.control.task import Task
from station.devices.interfaces import Condition


class Command(NamedTuple):
    """Station process -> control process."""

    number: int  #: echoed in the reply
    what: Event | Literal["tare", "jog"]
    task: Task | None = None  #: to START, or to carry out after HOME
    run: int = 0
    space: Space = "joints"  #: of a jog
    velocity: Array | None = None  #: of a jog [rad/s or m/s]
    cause: str = ""  #: of a HOLD or STOP
    until: float = math.inf  #: it is carried out by then or not at all, by the station's clock [s]


class Reply(NamedTuple):
    """Control process -> station process: the answer to a command."""

    number: int
    refused: str  #: empty when it was carried out


class Notice(NamedTuple):
    """Control process -> station process: the state has changed, or a motion begins or has ended."""

    state: State
    cause: str
    run: int  #: the run it is about
    motion_start: float | None = None  #: of the run's motion, by the station's clock [s]; None: none is on


class Refused(NamedTuple):
    """Control process -> station process, once: what the system has refused it."""

    warnings: tuple[str, ...]


DeviceName = Literal["stages", "tracker", "sensors"]


@dataclass(frozen=True)
class DeviceStatus:
    """Everything that is known of one device; what an installed driver says is not judged in the control process."""

    name: DeviceName
    condition: Condition
    severity: int
    """of what is wrong; 0: nothing"""
    text: str
    """what is wrong and what to do"""
    details: Mapping[str, Any]


class DeviceReport(NamedTuple):
    """Control process -> station process, once in a while."""

    devices: tuple[DeviceStatus, ...]
