"""Configuration of a Zaber stage: its joint, its counts, and its line."""

import math
from dataclasses import dataclass

from station.config.robots import JointFile
from station.devices.links.link import Link
from station.devices.zaber.protocol import (
    ACCELERATION_UNIT,
    MAX_POSITION,
    MICROSTEP_RESOLUTION,
    SPEED_UNIT,
    ZaberError,
    speed_data,
    top_speed,
)


@dataclass(frozen=True)
class StageSetup:
    """One stage: the joint that it moves and how its microsteps count."""

    joint: JointFile
    device: int  #: number on the chain
    home_at: float  #: joint position at the home sensor [rad or m]
    home_count: int  #: the unit's count there; anything but 0 is set after homing [microsteps]
    maximum: int  #: hardware maximum position, set in the unit [microsteps]
    home_speed: float  #: [rad/s or m/s]
    device_id: int | None = None  #: expected; None: any
    serial: int | None = None  #: expected; None: any, and old units have none
    backwards: bool = False  #: its count increases when the joint's position decreases

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
        """Return the default setup. A rotation has its sensor at joint 0, in the middle of its travel. A translation
        has it at the retracted end, where the unit counts 0. `home_at` is another position of the sensor [rad or m].

        Raises:
            ZaberError: the sensor of a translation is inside the travel; a stage cannot move beyond its sensor.
        """
        start, end = (joint.upper, joint.lower) if backwards else (joint.lower, joint.upper)
        turns = joint.motion == "rotation"
        if home_at is None:
            home_at = 0.0 if turns else start
        # An endless rotation may have any count at its sensor; a translation counts from 0 there.
        count = round(abs(home_at - start) / joint.microstep) if turns else 0
        inside = (home_at - start) * (-1.0 if backwards else 1.0)
        if not turns and inside > joint.microstep:
            raise ZaberError(
                f"{joint.name}: home_at {home_at:g} m is inside the travel {joint.lower:g} ... {joint.upper:g} m; "
                "a stage cannot move beyond its home sensor: change home_at or the joint's limits"
            )
        maximum = math.floor(abs(end - (start if turns else home_at)) / joint.microstep + 1e-6)
        return cls(joint, device, home_at, count, maximum, 0.25 * joint.speed, backwards=backwards)

    @property
    def step(self) -> float:
        """Change of the joint's position per microstep [rad or m]."""
        return -self.joint.microstep if self.backwards else self.joint.microstep

    @property
    def top(self) -> int:
        """Largest speed that is sent [speed units]."""
        return math.floor(self.joint.speed / self.joint.microstep / SPEED_UNIT)

    @property
    def home_units(self) -> int:
        """Home speed [speed units]."""
        return speed_data(self.home_speed / self.joint.microstep)

    @property
    def acceleration(self) -> int:
        """Acceleration of the unit, at least the joint's, on which braking distances rely [acceleration units]."""
        return math.ceil(self.joint.acceleration / self.joint.microstep / ACCELERATION_UNIT)

    def position(self, microsteps: float) -> float:
        """Return the joint position at a count [rad or m]."""
        return self.home_at + self.step * (microsteps - self.home_count)


@dataclass(frozen=True)
class PortSetup:
    """A line and the stages on it."""

    link: Link
    stages: tuple[int, ...]  #: their indices among the joints
