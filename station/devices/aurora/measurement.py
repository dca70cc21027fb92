"""Measurements of the tip's coil from frames, with their quality and counters."""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple


class FrameQuality(IntEnum):
    """Quality of the newest frame; telemetry contains the number."""

    GOOD = 0
    MISSING = 1  #: the unit does not detect the tool
    OUT_OF_VOLUME = 2  #: the tool is fully or partly outside the measurement volume
    DISABLED = 3  #: the tool is disabled or unplugged
    JUMP = 4  #: the position is further from the last one than a coil can move in the time between
    FAULT = 5  #: the unit reports a fault of the sensor or of itself
    SILENT = 6  #: no frame for `SILENCE_TIMEOUT_S`
    CONNECTING = 7
    LOST = 8  #: the port is lost


class TrackerFrame(NamedTuple):
    """One new frame of the tip's coil."""

    frame: int
    time: float  #: time of the measurement, from the frame number [s]
    quality: FrameQuality
    position: tuple[float, ...] | None  #: robot's tip in the field generator's frame, only when GOOD [mm]
    error: float = 0.0  #: error indicator of the unit [mm]
    target: tuple[float, ...] | None = None  #: target's coil in the generator's frame, only when good [mm]
    axis: tuple[float, ...] | None = (
        None  #: axis of the tip's coil, unit vector in the generator's frame, only when GOOD
    )


@dataclass
class FrameCounts:
    """Counters since the session was created."""

    frames: int = 0  #: new frames received
    repeated: int = 0  #: replies that repeat the last frame
    skipped: int = 0  #: frames that were not requested in time
    implausible: int = 0  #: frame numbers that do not fit the clock
    jumps: int = 0  #: frames whose position a coil cannot have reached
    malformed: int = 0  #: replies with a correct CRC and wrong content
    stray: int = 0  #: texts that answer no request
    timeouts: int = 0  #: requests without a reply in time
    connects: int = 0  #: how many times tracking has started
