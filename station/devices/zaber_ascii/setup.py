"""Configuration of Zaber ASCII stages: their options in the station file, and the conversion of their positions."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from station.config.robots import JointFile
from station.config.strict import MAX_SILENCE_S, Name, Positive, Strict
from station.devices.config import Serial
from station.devices.kernel.axis import CountedJoint, home_of
from station.devices.zaber_ascii.protocol import (
    ACCELERATION_FACTOR,
    MAX_ACCELERATION,
    MAX_POSITION,
    MICROSTEP_RESOLUTION,
    SPEED_FACTOR,
    ZaberAsciiError,
    speed_data,
)

#: Default of the longest time from sending a command to its reply: a USB adapter may delay bytes by 16 ms [s].
DEADLINE_S = 0.030


class AsciiStageFile(Strict):
    """One axis of a Zaber device."""

    device: Annotated[int, Field(ge=1, le=99)]
    """address of the device on the chain"""
    axis: Annotated[int, Field(ge=1, le=9)] = 1
    """number of the axis on its device"""
    home_at: float | None = None
    """joint position at the home sensor, any number [rad or m]; default: 0 for a rotation, and for a translation the
    end of the travel at which the axis counts 0"""
    backwards: bool = False
    """whether the axis's count increases when the joint's position decreases"""
    home_speed: Positive | None = None
    """speed of homing [rad/s or m/s]; default: a quarter of the joint's speed"""
    serial: Annotated[int, Field(ge=0)] | None = None
    """serial number that the device must report"""


class AsciiFile(Strict):
    """Zaber stages with the ASCII protocol on one chain."""

    port: Serial
    """port of the chain"""
    joints: Mapping[Name, AsciiStageFile] = {}
    """the axis of each joint; default: devices 1, 2, ... in the order of the robot's joints"""
    deadline: Annotated[float, Field(ge=0.01, le=MAX_SILENCE_S)] = DEADLINE_S
    """longest time from sending a command to its reply [s]; a stage is lost after four missing replies in a row"""


@dataclass(frozen=True)
class AsciiSetup(CountedJoint):
    """One stage: the joint that it moves, and the conversion of its microsteps, counted from the home sensor."""

    device: int
    axis: int = 1
    serial: int | None = None  #: expected serial number; None: any

    @classmethod
    def of(cls, joint: JointFile, file: AsciiStageFile) -> "AsciiSetup":
        """Return the setup of a joint.

        Raises:
            ZaberAsciiError: the sensor of a translation is inside the travel, or a value is out of its range.
        """
        home_at, home_speed = home_of(joint, file)
        setup = cls(joint, home_at, home_speed, file.device, file.axis, file.serial, backwards=file.backwards)
        if joint.motion == "translation" and setup.minimum < 0:
            raise ZaberAsciiError(
                f"{joint.name}: home_at {home_at:g} m is inside the travel {joint.lower:g} ... {joint.upper:g} m; "
                "a stage cannot move beyond its home sensor: change home_at or the joint's limits"
            )
        largest = 16384 * MICROSTEP_RESOLUTION
        for what, value, least, most in (
            ("lower end of the travel", setup.minimum, -MAX_POSITION, MAX_POSITION),
            ("upper end of the travel", setup.maximum, -MAX_POSITION, MAX_POSITION),
            ("speed", setup.top, 1, largest),
            ("home_speed", setup.home_data, 1, largest),
            ("acceleration", setup.acceleration, 1, MAX_ACCELERATION),
        ):
            if not least <= value <= most:
                raise ZaberAsciiError(f"{joint.name}: {what} of {value} device units is outside {least} ... {most}")
        return setup

    @property
    def velocity_step(self) -> float:
        """Joint velocity per unit of a velocity command [rad/s or m/s]."""
        return self.step / SPEED_FACTOR

    @property
    def top(self) -> int:
        """Largest speed that the host sends [speed data]."""
        return speed_data(self.joint.speed / self.joint.microstep)

    @property
    def home_data(self) -> int:
        """Speed of homing [speed data]."""
        return speed_data(self.home_speed / self.joint.microstep)

    @property
    def acceleration(self) -> int:
        """Acceleration setting, at least the joint's value that braking distances assume [acceleration data]."""
        return math.ceil(self.joint.acceleration / self.joint.microstep * ACCELERATION_FACTOR)
