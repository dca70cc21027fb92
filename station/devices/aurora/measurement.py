"""What a session makes of frames: measurements of the tip's coil, what they are worth, and what was counted."""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple


class Quality(IntEnum):
    """What the newest frame is worth; the number is what telemetry carries."""

    GOOD = 0
    MISSING = 1  #: the unit does not see the tool
    OUT_OF_VOLUME = 2  #: also partly
    DISABLED = 3  #: or unplugged
    JUMP = 4  #: further from the last position than a coil can move
    FAULT = 5  #: the unit reports a fault of the sensor or of itself
    SILENT = 6  #: no frame for a while
    CONNECTING = 7
    LOST = 8  #: the port is gone


class Measurement(NamedTuple):
    """One new frame of the tip's coil."""

    frame: int
    time: float  #: when it was measured, by the frame number [s]
    quality: Quality
    position: tuple[float, ...] | None  #: of the robot's tip in the field generator's frame, only when GOOD [mm]
    error: float = 0.0  #: the unit's own figure [mm]
    target: tuple[float, ...] | None = None  #: of the target's coil in the same frame, only when good [mm]
    axis: tuple[float, ...] | None = None  #: of the tip's coil, unit vector in the generator's frame, only when GOOD


@dataclass
class Counts:
    """What happened so far."""

    frames: int = 0  #: new ones
    repeated: int = 0  #: replies with a frame that was known already
    skipped: int = 0  #: frames that were never asked for in time
    implausible: int = 0  #: frame numbers that do not fit the clock
    jumps: int = 0
    malformed: int = 0  #: replies with a good CRC that are none
    stray: int = 0  #: text that answers nothing
    timeouts: int = 0
    connects: int = 0  #: times that tracking has begun
