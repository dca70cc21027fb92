"""Everything about a running station at one look."""

from collections.abc import Mapping
from typing import NamedTuple

from core.robot.robot import Array
from station.control.messages import DeviceStatus
from station.control.ring import Timing
from station.control.states import State
from station.control.task import Phase

#: Telemetry older than this is shown as stale [s].
STALE = 0.5


class Status(NamedTuple):
    """One look says everything."""

    state: State
    cause: str  #: why it is HOLD, STOPPED or FAULT
    run: str  #: the run that is on, or the last one; empty before the first
    title: str  #: of that run
    phase: Phase
    progress: float  #: part of the motion that is done
    age: float  #: since the last tick [s]
    timing: Timing
    values: Mapping[str, Array]  #: newest telemetry by group; empty until there is some
    devices: tuple[DeviceStatus, ...] = ()  #: as reported last; empty before
    warnings: tuple[str, ...] = ()  #: of this machine and this robot
    reserved: str = ""  #: why nobody but a procedure may move anything; empty when everybody may
