"""Configuration of Zaber stages: their options in the station file, joint, microstep count, and serial line."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from station.config.robots import JointFile
from station.config.strict import MAX_SILENCE_S, Name, Positive, Strict
from station.devices.config import Serial
from station.devices.kernel.axis import CountedJoint, home_of
from station.devices.zaber.chain import LineSettings
from station.devices.zaber.protocol import (
    ACCELERATION_UNIT,
    MAX_POSITION,
    MICROSTEP_RESOLUTION,
    SPEED_UNIT,
    ZaberError,
    speed_data,
    top_speed,
)


class StageFile(Strict):
    """One Zaber unit."""

    port: Serial | None = None
    """port of this stage alone; default: the chain's port"""
    device: Annotated[int, Field(ge=1, le=254)]
    """device number of the unit on the chain"""
    home_at: float | None = None
    """joint position at the home sensor, any number [rad or m]; default: 0 for a rotation, and for a translation the
    end of the travel at which the unit counts 0"""
    backwards: bool = False
    """whether the unit's count increases when the joint's position decreases"""
    home_speed: Positive | None = None
    """speed of homing [rad/s or m/s]; default: a quarter of the joint's speed"""
    device_id: Annotated[int, Field(ge=0)] | None = None
    """device id that the unit must report"""
    serial: Annotated[int, Field(ge=0)] | None = None
    """serial number that the unit must report"""


class ZaberFile(Strict):
    """Zaber T-series stages on one chain, or with a separate port for each stage."""

    port: Serial | None = None
    """port of the chain"""
    joints: Mapping[Name, StageFile] = {}
    """the unit of each joint; default: device numbers 1, 2, ... in the order of the robot's joints"""
    deadline: Annotated[float, Field(ge=0.02, le=MAX_SILENCE_S)] = LineSettings.deadline
    """longest time from the start of a request to its reply [s]; a stage is lost after two missing replies in a row"""


@dataclass(frozen=True)
class StageSetup(CountedJoint):
    """One stage: the joint that it moves, and the conversion between its count of microsteps and joint positions."""

    device: int  #: device number on the chain
    device_id: int | None = None  #: expected device ID; None: any
    serial: int | None = None  #: expected serial number; None: any, as for old units, which report no number

    def __post_init__(self) -> None:
        name = self.joint.name
        for what, value, upper in (
            ("device number", self.device, 254),
            ("maximum position", self.maximum, MAX_POSITION),
        ):
            if not 1 <= value <= upper:
                raise ZaberError(f"{name}: {what} {value} is outside 1 ... {upper}")
        if not 0 <= self.home_count <= self.maximum:
            raise ZaberError(f"{name}: home count {self.home_count} is outside 0 ... {self.maximum} microsteps")
        for what, value in (
            ("top speed", self.top),
            ("home speed", self.home_units),
            ("acceleration", self.acceleration),
        ):
            if not 1 <= value <= top_speed(MICROSTEP_RESOLUTION):
                raise ZaberError(f"{name}: {what} of {value} units is outside 1 ... {top_speed(MICROSTEP_RESOLUTION)}")

    @classmethod
    def of(cls, joint: JointFile, device: int, home_at: float | None = None, backwards: bool = False) -> "StageSetup":
        """Return a setup with default options; `home_at`: joint position at the home sensor [rad or m], None: default.

        Raises:
            ZaberError: a value is out of its range, see `of_file`.
        """
        return cls.of_file(joint, StageFile(device=device, home_at=home_at, backwards=backwards))

    @classmethod
    def of_file(cls, joint: JointFile, file: StageFile) -> "StageSetup":
        """Return the setup of a joint from its table.

        Raises:
            ZaberError: a value is out of its range, or the sensor of a translation is inside the travel; a stage cannot
                move beyond its sensor.
        """
        setup = cls(joint, *home_of(joint, file), file.device, file.device_id, file.serial, backwards=file.backwards)
        inside = (setup.home_at - setup._start) * (-1.0 if file.backwards else 1.0)
        if joint.motion == "translation" and inside > joint.microstep:
            raise ZaberError(
                f"{joint.name}: home_at {setup.home_at:g} m is inside the travel {joint.lower:g} ... {joint.upper:g} m;"
                " a stage cannot move beyond its home sensor: change home_at or the joint's limits"
            )
        return setup

    @property
    def _start(self) -> float:
        """Joint position at the end of the travel from which the unit counts up [rad or m]."""
        return self.joint.upper if self.backwards else self.joint.lower

    @property
    def home_count(self) -> int:
        """The unit's count at the home sensor; if it is not 0, the driver sets it after homing [microsteps].

        A rotation stage without end stops may have any count at its sensor; a translation stage counts 0 there.
        """
        turns = self.joint.motion == "rotation"
        return round(abs(self.home_at - self._start) / self.joint.microstep) if turns else 0

    @property
    def minimum(self) -> int:
        """Lower limit of the travel [microsteps]."""
        return 0

    @property
    def maximum(self) -> int:
        """Hardware maximum position, which the driver sets in the unit [microsteps]."""
        end = self.joint.lower if self.backwards else self.joint.upper
        start = self._start if self.joint.motion == "rotation" else self.home_at
        return math.floor(abs(end - start) / self.joint.microstep + 1e-6)

    @property
    def velocity_step(self) -> float:
        """Joint velocity per speed unit [rad/s or m/s]."""
        return SPEED_UNIT * self.step

    @property
    def top(self) -> int:
        """Largest speed that the host sends [speed units]."""
        return math.floor(self.joint.speed / self.joint.microstep / SPEED_UNIT)

    @property
    def home_units(self) -> int:
        """Speed of homing [speed units]."""
        return speed_data(self.home_speed / self.joint.microstep)

    @property
    def acceleration(self) -> int:
        """Acceleration setting, at least the joint's value that braking distances assume [acceleration units]."""
        return math.ceil(self.joint.acceleration / self.joint.microstep / ACCELERATION_UNIT)
