"""What is told about a Zaber stage before it is connected: its joint, its counts, and the line that it is on."""

import math
from dataclasses import dataclass

from station.config.robots import JointFile
from station.devices.links.link import Link
from station.devices.zaber.protocol import (
    ACCELERATION_UNIT,
    MOST_POSITION,
    RESOLUTION,
    SPEED_UNIT,
    ZaberError,
    speed_data,
    top_speed,
)


@dataclass(frozen=True)
class StageSetup:
    """One stage: the joint that it moves and how its microsteps count."""

    joint: JointFile
    device: int  #: its number on the chain
    home_at: float  #: joint position at the home sensor [rad or m]
    home_count: int  #: the unit's count there; anything but 0 is set after homing [microsteps]
    maximum: int  #: hardware maximum position, set in the unit [microsteps]
    home_speed: float  #: [rad/s or m/s]
    device_id: int | None = None  #: expected; None: any
    serial: int | None = None  #: expected; None: any, and old units have none
    backwards: bool = False  #: its count rises where the joint's position falls

    def __post_init__(self) -> None:
        name = self.joint.name
        for what, value, most in (
            ("device number", self.device, 254),
            ("maximum position", self.maximum, MOST_POSITION),
        ):
            if not 1 <= value <= most:
                raise ZaberError(f"{name}: {what} {value} is outside 1 ... {most}")
        if not 0 <= self.home_count <= self.maximum:
            raise ZaberError(f"{name}: home count {self.home_count} is outside 0 ... {self.maximum} microsteps")
        for what, value in (
            ("top speed", self.top),
            ("home speed", self.home_units),
            ("acceleration", self.acceleration),
        ):
            if not 1 <= value <= top_speed(RESOLUTION):
                raise ZaberError(f"{name}: {what} of {value} units is outside 1 ... {top_speed(RESOLUTION)}")

    @classmethod
    def of(cls, joint: JointFile, device: int, home_at: float | None = None, backwards: bool = False) -> "StageSetup":
        """The usual one: a rotation has its sensor at joint 0, with as much travel either way; a translation
        has it at the retracted end, where the unit counts 0. `home_at` is where else the sensor is [rad or m].

        Raises:
            ZaberError: the sensor of a translation is inside the travel, which could not be used behind it.
        """
        begin, end = (joint.upper, joint.lower) if backwards else (joint.lower, joint.upper)
        turns = joint.motion == "rotation"
        if home_at is None:
            home_at = 0.0 if turns else begin
        # A unit that turns on and on may count anything at its sensor; another counts from 0 there.
        count = round(abs(home_at - begin) / joint.microstep) if turns else 0
        inside = (home_at - begin) * (-1.0 if backwards else 1.0)
        if not turns and inside > joint.microstep:
            raise ZaberError(
                f"{joint.name}: home_at {home_at:g} m is inside the travel {joint.lower:g} ... {joint.upper:g} m; "
                "behind its home sensor a stage cannot go: change home_at or the joint's limits"
            )
        maximum = math.floor(abs(end - (begin if turns else home_at)) / joint.microstep + 1e-6)
        return cls(joint, device, home_at, count, maximum, 0.25 * joint.speed, backwards=backwards)

    @property
    def step(self) -> float:
        """What a microstep adds to the joint's position [rad or m]."""
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
        """Never less than the joint's, on which braking distances rely [acceleration units]."""
        return math.ceil(self.joint.acceleration / self.joint.microstep / ACCELERATION_UNIT)

    def position(self, microsteps: float) -> float:
        """Joint position at a count [rad or m]."""
        return self.home_at + self.step * (microsteps - self.home_count)


@dataclass(frozen=True)
class Port:
    """A line and the stages on it."""

    link: Link
    stages: tuple[int, ...]  #: their places among the joints
