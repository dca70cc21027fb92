"""Reports of the control process to the station process; `commands` contains the commands and their replies."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from station.control.states import State
from station.devices.interfaces import Condition


class StateNotice(NamedTuple):
    """Message of the control process to the station process about a new state, or the start or end of a motion."""

    state: State
    cause: str
    run: int  #: number of the run that the notice is about
    motion_start: float | None = None  #: start of the run's motion, by the station's clock [s]; None: no motion
    details: str = ""  #: addresses and raw values that belong to the cause
    contact: str = ""  #: why the tip may have contact after the last motion, tare or reset; empty without contact


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
