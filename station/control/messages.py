"""Messages between the station process and the control process."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from core.robot.robot import Array
from station.control.states import State, Transition
from station.control.task import MotionTask, Space
from station.devices.interfaces import Condition

#: Change of state or action that a command requests.
CommandKind = Transition | Literal["tare", "jog", "stiffness"]


class Command(NamedTuple):
    """Command from the station process to the control process."""

    number: int  #: number of the command, repeated in its reply
    what: CommandKind
    task: MotionTask | None = None  #: motion to START, or to execute after HOME
    run: int = 0  #: number of the run that the task belongs to
    space: Space = "joints"  #: what a jog moves
    velocity: Array | None = None  #: velocity of a jog [rad/s or m/s]
    stiffness: tuple[float, float, float] | None = None  #: stiffness of the tip along its axes, for `stiffness` [N/m]
    cause: str = ""  #: reason of a HOLD or STOP
    until: float = math.inf  #: deadline after which the command is rejected, by the station's clock [s]
    #: number of STOPs and resets before the request; a later one voids the command; None: never void
    generation: int | None = None


class Reply(NamedTuple):
    """Answer of the control process to a command of the station process."""

    number: int  #: number of the command
    refused: str  #: reason of the refusal; empty when the command was executed


class StateNotice(NamedTuple):
    """Message of the control process to the station process about a new state, or the start or end of a motion."""

    state: State
    cause: str
    run: int  #: number of the run that the notice is about
    motion_start: float | None = None  #: start of the run's motion, by the station's clock [s]; None: no motion
    details: str = ""  #: addresses and raw values that belong to the cause


class CommandRefused(NamedTuple):
    """Message of the control process, sent once at its start, about real-time rights that the system has refused."""

    warnings: tuple[str, ...]


DeviceName = Literal["stages", "tracker", "sensors"]


@dataclass(frozen=True)
class DeviceStatus:
    """Status of one device; `details` of an installed driver may be any picklable mapping."""

    name: DeviceName
    condition: Condition
    severity: int
    """severity of the fault; 0: none"""
    text: str
    """description of the fault, with an instruction and the device's address"""
    details: Mapping[str, Any]


class DeviceReport(NamedTuple):
    """Message of the control process about the status of every device, sent at regular intervals."""

    devices: tuple[DeviceStatus, ...]
