"""Configuration of the axes of a G-code board: their options in the station file, and their units."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from station.config.robots import JointFile
from station.config.strict import MAX_SILENCE_S, Name, Positive, Strict
from station.devices.config import Serial
from station.devices.gcode.protocol import Dialect, GcodeError
from station.devices.kernel.axis import CountedJoint, home_of

Letter = Literal["X", "Y", "Z", "A", "B", "C"]
LETTERS: tuple[Letter, ...] = ("X", "Y", "Z", "A", "B", "C")
VELOCITY_DATA = 1000.0  #: value of a velocity command that means one microstep per second
RAMP_S = 0.040  #: default time in which the firmware accelerates a joint to its largest speed [s]
DEADLINE_S = 0.1  #: default of the longest silence of a board that was queried [s]


class GcodeAxisFile(Strict):
    """One axis of a G-code board."""

    letter: Letter
    """letter of the axis in G-code: X, Y, Z, A, B or C"""
    units: Positive | None = None
    """change of the axis's coordinate per joint unit [1/rad or 1/m]; default: degrees for a rotation, mm for a
    translation"""
    home_at: float | None = None
    """joint position at the axis's coordinate 0, any number [rad or m]; default: 0 for a rotation, and for a
    translation the end of the travel from which the axis counts up"""
    backwards: bool = False
    """whether the axis's coordinate increases when the joint's position decreases"""
    home_speed: Positive | None = None
    """speed of homing in the firmware, for the progress display [rad/s or m/s]; default: a quarter of the joint's
    speed"""
    acceleration: Positive | None = None
    """acceleration of the firmware [rad/s^2 or m/s^2]; default: the joint's acceleration, or the one that reaches the
    joint's speed in 0.04 s, whichever is larger"""


class GcodeFile(Strict):
    """The axes of one G-code board with GRBL 1.1 or Marlin 2."""

    port: Serial
    """port of the board"""
    dialect: Dialect
    """firmware of the board: `grbl` or `marlin`"""
    baud: Annotated[int, Field(ge=9600, le=4_000_000)] | None = None
    """baud rate of the port [bit/s]; default: 115200 for `grbl`, 250000 for `marlin`"""
    homing: Literal["firmware", "here"] = "firmware"
    """`firmware`: the board homes each axis by its switch; `here`: the operator has moved every joint to its `home_at`
    by hand, so the present position counts as home"""
    joints: Mapping[Name, GcodeAxisFile] = {}
    """the axis of each joint; default: X, Y, Z, A, B, C in the order of the robot's joints"""
    deadline: Annotated[float, Field(ge=0.02, le=MAX_SILENCE_S)] = DEADLINE_S
    """longest time without a valid position before the board counts as lost; the axes stop after half of it [s]"""


@dataclass(frozen=True)
class AxisSetup(CountedJoint):
    """One axis: the joint that it moves, and the conversion of its coordinate; one count is `joint.microstep`."""

    letter: Letter
    units: float  #: units of the coordinate per joint unit
    joint_acceleration: float  #: acceleration of the firmware [rad/s^2 or m/s^2]

    @classmethod
    def of(cls, joint: JointFile, file: GcodeAxisFile) -> "AxisSetup":
        """Return the setup of a joint; raises GcodeError if its `acceleration` is below the robot's."""
        setup = cls(
            joint,
            *home_of(joint, file),
            file.letter,
            file.units or (math.degrees(1.0) if joint.motion == "rotation" else 1000.0),
            file.acceleration or max(joint.acceleration, joint.speed / RAMP_S),
            backwards=file.backwards,
        )
        if setup.joint_acceleration < joint.acceleration:
            raise GcodeError(
                f"{joint.name}: acceleration = {setup.joint_acceleration:g} is below the robot's "
                f"{joint.acceleration:g}, which braking distances assume; raise it or change the robot's file"
            )
        return setup

    @property
    def unit(self) -> float:
        """Units of the coordinate per count."""
        return self.joint.microstep * self.units

    @property
    def velocity_step(self) -> float:
        """Joint velocity per unit of a velocity command [rad/s or m/s]."""
        return self.step / VELOCITY_DATA

    @property
    def top(self) -> float:
        """Largest speed [counts/s]."""
        return self.joint.speed / self.joint.microstep

    @property
    def acceleration(self) -> float:
        """Acceleration of the firmware [counts/s^2]."""
        return self.joint_acceleration / self.joint.microstep
