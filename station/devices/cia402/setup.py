"""Configuration of CANopen drives: their options in the station file, and the conversion of their encoder counts."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from station.config.robots import JointFile
from station.config.strict import MAX_SILENCE_S, Name, Positive, Strict
from station.devices.cia402.makes import MAKES, Make
from station.devices.cia402.protocol import HOST_NODE, CanError
from station.devices.config import Serial
from station.devices.kernel.axis import CountedJoint, home_of

DEADLINE_S = 0.030  #: default of the longest silence of a drive [s]
MAX_COUNT = 2**31 - 1  #: largest value of a position or velocity in a drive


class DriveFile(Strict):
    """One drive on the bus."""

    node: Annotated[int, Field(ge=1, lt=HOST_NODE)]
    """node number of the drive"""
    make: Make = "generic"
    """make of the drive, which sets its units: `generic` (velocities in counts per second), `epos4` or `faulhaber`"""
    counts_per_turn: Positive | None = None
    """encoder counts per turn of the motor [counts]; required for `epos4` and `faulhaber`"""
    home_at: float | None = None
    """joint position at the home sensor, any number [rad or m]; default: 0 for a rotation, and for a translation the
    end of the travel at which the drive counts 0"""
    backwards: bool = False
    """whether the drive's count increases when the joint's position decreases"""
    home_speed: Positive | None = None
    """speed of homing [rad/s or m/s]; default: a quarter of the joint's speed"""
    homing_method: Annotated[int, Field(ge=-128, le=127)] | None = None
    """method of homing, object 0x6098; default: 17 (negative limit switch) for a translation; 21, for `epos4` 27 (home
    switch, negative direction) for a rotation"""
    serial: Annotated[int, Field(ge=0)] | None = None
    """serial number that the drive must report"""


class Cia402File(Strict):
    """CANopen drives with the profile CiA 402 on one bus, by a serial CAN adapter (slcan)."""

    port: Serial
    """port of the adapter"""
    joints: Mapping[Name, DriveFile] = {}
    """the drive of each joint; default: nodes 1, 2, ... in the order of the robot's joints"""
    deadline: Annotated[float, Field(ge=0.02, le=MAX_SILENCE_S)] = DEADLINE_S
    """longest silence of a drive before it counts as lost [s]; the drives stop if the station is silent for 0.07 s
    longer than this"""


@dataclass(frozen=True)
class DriveSetup(CountedJoint):
    """One drive: the joint that it moves, and the conversion of its counts. `joint.microstep` is one count."""

    node: int
    homing_method: int
    make: Make = "generic"
    velocity_unit: float = 1.0  #: the drive's unit of velocity [counts/s]
    acceleration_unit: float = 1.0  #: the drive's unit of acceleration [counts/s^2]
    serial: int | None = None  #: expected serial number; None: any

    @classmethod
    def of(cls, joint: JointFile, file: DriveFile) -> "DriveSetup":
        """Return the setup of a joint.

        Raises:
            CanError: the sensor of a translation is inside the travel, a value is out of its range, or the counts per
                turn are missing.
        """
        turns, (home_at, home_speed), unit, ramp = joint.motion == "rotation", home_of(joint, file), 1.0, 1.0
        make = MAKES[file.make]
        if make.velocities_per_turn and make.accelerations_per_turn:
            if file.counts_per_turn is None:
                raise CanError(f"{joint.name}: counts_per_turn is missing; a drive of make '{file.make}' needs it")
            unit = file.counts_per_turn / make.velocities_per_turn
            ramp = file.counts_per_turn / make.accelerations_per_turn
        method = file.homing_method
        if method is None:
            method = make.rotation_method if turns else 17
        if (known := make.homing_methods) is not None and method not in known:
            raise CanError(
                f"{joint.name}: homing_method = {method}: a drive of make '{file.make}' has only"
                f" {', '.join(map(str, sorted(known)))}"
            )
        setup = cls(
            joint, home_at, home_speed, file.node, method, file.make, unit, ramp, file.serial, backwards=file.backwards
        )
        if not turns and setup.minimum < 0:
            raise CanError(
                f"{joint.name}: home_at {home_at:g} m is inside the travel {joint.lower:g} ... {joint.upper:g} m; "
                "a stage cannot move beyond its home sensor: change home_at or the joint's limits"
            )
        for what, value, least in (
            ("lower end of the travel", setup.minimum, -MAX_COUNT),
            ("upper end of the travel", setup.maximum, -MAX_COUNT),
            ("speed", setup.top, 1),
            ("home_speed", setup.units(setup.home_speed), 1),
            ("acceleration", setup.acceleration, 1),
        ):
            if not least <= value <= MAX_COUNT:
                raise CanError(f"{joint.name}: {what} of {value} drive units is outside {least} ... {MAX_COUNT}")
        return setup

    @property
    def velocity_step(self) -> float:
        """Joint velocity per velocity unit of the drive [rad/s or m/s]."""
        return self.step * self.velocity_unit

    @property
    def top(self) -> int:
        """Largest speed that the host sends [velocity unit]."""
        return self.units(self.joint.speed)

    @property
    def acceleration(self) -> int:
        """Acceleration and deceleration, at least those that braking distances assume [acceleration unit]."""
        return math.ceil(self.joint.acceleration / abs(self.step * self.acceleration_unit))

    def units(self, speed: float) -> int:
        """Return a speed [rad/s or m/s] in the drive's unit."""
        return round(speed / abs(self.velocity_step))
