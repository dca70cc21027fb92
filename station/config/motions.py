"""Motions as people write them, in files and over REST: checked here, carried out by `core.control.trajectories`."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from core.control.reachability import check_reach
from core.control.step import Controller
from core.control.trajectories import (
    Circle,
    Directions,
    Helix,
    Hold,
    JointMotion,
    Setpoint,
    Sinusoid,
    Step,
    Trajectory,
    Waypoints,
)
from core.errors import DescriptionError, Unreachable
from core.robot.limits import Limits
from core.robot.robot import Array, Robot
from station.config.strict import ConfigError, Direction, Positive, Row, Strict, Vector, check, read_text

_Rows = tuple[tuple[float, float, float, float], ...]


class _Pointed(Strict):
    """A motion along which the tip may point somewhere, where the controller's task asks for a direction."""

    directions: Annotated[tuple[Annotated[tuple[float, float, float, float], Row], ...], Field(strict=False)] = ()
    """time [s] and the direction x, y, z in which the tip then points; empty keeps that of the start"""

    @field_validator("directions")
    @classmethod
    def _can_be(cls, rows: _Rows) -> _Rows:
        try:
            directions_of(rows)
        except DescriptionError as error:
            raise ValueError(str(error)) from None
        return rows


def directions_of(rows: _Rows) -> Directions | None:
    """Where the tip points over time; None keeps the direction of the start."""
    return Directions(tuple(row[0] for row in rows), tuple(row[1:] for row in rows)) if rows else None


class HoldMotion(_Pointed):
    """Keep the tip where it is."""

    kind: Literal["hold"] = "hold"

    def trajectory(self) -> Trajectory:
        """What the controller follows."""
        return Hold()


class SinusoidMotion(_Pointed):
    """Move the tip back and forth along a line."""

    kind: Literal["sinusoid"] = "sinusoid"
    direction: Direction = (0.0, 0.0, 1.0)
    """of the line, world frame; its length does not matter"""
    amplitude: Annotated[float, Field(gt=0.0, le=0.1)]
    """to either side [m]"""
    frequency: Annotated[float, Field(gt=0.0, le=5.0)]
    """there and back in a second [Hz]"""

    def trajectory(self) -> Trajectory:
        """What the controller follows."""
        return Sinusoid(self.direction, self.amplitude, self.frequency)


class CircleMotion(_Pointed):
    """Move the tip along a circle through its start."""

    kind: Literal["circle"] = "circle"
    radius: Annotated[float, Field(gt=0.0, le=0.1)]
    """of the circle [m]"""
    period: Annotated[float, Field(ge=0.2, le=3600.0)]
    """time for one turn [s]"""
    normal: Direction = (0.0, 0.0, 1.0)
    """axis of the circle, world frame; its length does not matter"""

    def trajectory(self) -> Trajectory:
        """What the controller follows."""
        return Circle(self.radius, self.period, self.normal)


class HelixMotion(_Pointed):
    """Turn the tip about an axis while it advances along it."""

    kind: Literal["helix"] = "helix"
    radius: Annotated[float, Field(gt=0.0, le=0.1)]
    """of the turns [m]"""
    pitch: Annotated[float, Field(ge=-0.1, le=0.1)]
    """advance in one turn [m]; negative the other way"""
    turn: Annotated[float, Field(ge=0.2, le=3600.0)]
    """time for one turn [s]"""
    turns: Annotated[float, Field(gt=0.0, le=1000.0)]
    """how many, then the tip stays"""
    axis: Direction = (0.0, 0.0, 1.0)
    """along which it advances, world frame; its length does not matter"""

    def trajectory(self) -> Trajectory:
        """What the controller follows."""
        return Helix(self.radius, self.pitch, self.turn, self.turns, self.axis)


class StepMotion(_Pointed):
    """Ask for another place at once, to see how the controller gets there."""

    kind: Literal["step"] = "step"
    offset: Vector
    """from the start tip [m]"""
    stay: Annotated[float, Field(gt=0.0, le=3600.0)] | None = None
    """at either place, there and back again [s]; once and for all when left out"""

    def trajectory(self) -> Trajectory:
        """What the controller follows."""
        return Step(self.offset, math.inf if self.stay is None else self.stay)


class Places(_Pointed):
    """Places and times as they are written down, whether or not they can be followed."""

    points: tuple[Annotated[tuple[float, float, float, float], Row], ...] = Field(
        min_length=1, max_length=10_000, strict=False
    )
    """time [s] and offset x, y, z from the start tip [m]; the first time is that of the way there"""
    max_speed: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """of the tip [m/s]"""
    max_acceleration: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """of the tip on its way through the points [m/s^2]"""

    def trajectory(self) -> Waypoints:
        """What the controller follows.

        Raises:
            DescriptionError: times that do not rise, or a way that is too fast, with the time.
        """
        times, places = tuple(row[0] for row in self.points), tuple(row[1:] for row in self.points)
        return Waypoints(times, places, self.max_speed, self.max_acceleration)


class WaypointsMotion(Places):
    """Through places at given times, smoothly, from rest to rest."""

    kind: Literal["waypoints"] = "waypoints"

    @model_validator(mode="after")
    def _possible(self) -> Self:
        try:
            self.trajectory()
        except DescriptionError as error:
            raise ValueError(str(error)) from None
        return self


class FollowMotion(Strict):
    """Keep the tip beside a target that moves and has a coil of its own."""

    kind: Literal["follow"] = "follow"
    offset: Vector | None = None
    """of the tip from the target [m]; as at the start when left out"""
    predict: bool = True
    """go where the target will be by its rhythms; without, to where the newest frame saw it"""
    lag: Annotated[float, Field(ge=0.0, le=0.2)] = 0.02
    """from a velocity's arrival at the stages until the tip has it, on top of the line's delays [s]"""
    max_speed: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """of the tip [m/s]"""
    max_acceleration: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """of the tip [m/s^2]"""
    patience: Annotated[float, Field(ge=0.25, le=60.0)] = 2.0
    """a target that is lost for longer ends the run in HOLD [s]"""

    def trajectory(self) -> Trajectory:
        """What is known of it beforehand: where it begins."""
        return Hold()


class CsvMotion(Strict):
    """Waypoints from a file; for experiment files, not over REST."""

    kind: Literal["csv"] = "csv"
    file: str
    """with the columns time, x, y, z [s, m]"""
    max_speed: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """of the tip [m/s]"""
    max_acceleration: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """of the tip on its way through the points [m/s^2]"""

    def trajectory(self) -> Trajectory:
        """What the controller follows.

        Raises:
            ConfigError: the file cannot be read or says something else.
        """
        text = read_text(Path(self.file))
        return waypoints_from_csv(text, self.file, self.max_speed, self.max_acceleration).trajectory()


def waypoints_from_csv(
    text: str, source: str, max_speed: float = 0.02, max_acceleration: float = 0.1
) -> WaypointsMotion:
    """Waypoints from lines of time, x, y, z [s, m]; a first line of names and empty lines are passed over.

    Raises:
        ConfigError: with source and line.
    """
    points: list[tuple[float, ...]] = []
    for number, line in enumerate(text.splitlines(), 1):
        cells = [cell.strip() for cell in line.split(",")]
        if not any(cells) or (not points and cells[0].lower().startswith("time")):
            continue
        try:
            point = tuple(float(cell) for cell in cells)
        except ValueError:
            raise ConfigError(f"{source}: line {number}: {line[:60]!r} is not time, x, y, z in numbers") from None
        if len(point) != 4:
            raise ConfigError(f"{source}: line {number}: {len(point)} numbers; expected time, x, y, z")
        points.append(point)
    table = {"points": points, "max_speed": max_speed, "max_acceleration": max_acceleration}
    return check(WaypointsMotion, table, source)


class JointSweepMotion(Strict):
    """Turn or slide one joint at constant speed; the tip is not controlled."""

    kind: Literal["joint_sweep"] = "joint_sweep"
    joint: str
    """by name"""
    speed: float
    """up to the joint's own, greater than 0, or below 0 for the other way [rad/s or m/s]"""
    distance: Positive
    """from the start [rad or m]"""

    @field_validator("speed")
    @classmethod
    def _moves(cls, speed: float) -> float:
        if speed == 0.0:
            raise ValueError("a sweep needs a speed that is not 0")
        return speed

    def check(self, start: Array, limits: Limits) -> None:
        """Refuse a sweep that joints beginning at `start` (n,) cannot make.

        Raises:
            DescriptionError: faster than the joint's limit.
            PoseError: it leaves the joint's travel.
        """
        at = [limit.name for limit in limits.joints].index(self.joint)
        limit = limits.joints[at]
        if abs(self.speed) > limit.speed:
            raise DescriptionError(
                f"joint_sweep: speed {self.speed:g} {limit.unit}/s is outside +-{limit.speed:g} {limit.unit}/s"
            )
        end = start.copy()
        end[at] += math.copysign(self.distance, self.speed)
        # A full turn ends at the end of the travel, give or take a rounding.
        nearest = min(max(end[at], limit.lower), limit.upper)
        if abs(end[at] - nearest) > 1e-9 * self.distance:
            limits.check(end)


#: What can be asked for in a file and over REST alike.
TipMotion = HoldMotion | SinusoidMotion | CircleMotion | HelixMotion | WaypointsMotion | StepMotion | FollowMotion
Motion = Annotated[TipMotion | CsvMotion | JointSweepMotion, Field(discriminator="kind")]


class Orders:
    """What the controller is told at each moment of a motion."""

    def __init__(self, motion: TipMotion | CsvMotion | JointSweepMotion, robot: Robot) -> None:
        """Raises DescriptionError when the robot has no such joint, ConfigError for a file that is none."""
        self._motion = motion
        #: The target decides where the tip should be; `at` says where it begins.
        self.follow = motion if isinstance(motion, FollowMotion) else None
        self._trajectory: Trajectory | None = None
        self._directions = directions_of(motion.directions) if isinstance(motion, _Pointed) else None
        if isinstance(motion, JointSweepMotion):
            if motion.joint not in robot.joint_names:
                raise DescriptionError(f"joint_sweep: '{motion.joint}' is not one of {', '.join(robot.joint_names)}")
            self._sweep = np.zeros(len(robot.joints))
            self._sweep[robot.joint_names.index(motion.joint)] = motion.speed
            self._sweep_end = motion.distance / abs(motion.speed)
        else:
            self._trajectory = motion.trajectory()

    def check(
        self, controller: Controller, start: Array, duration: float, force: Callable[[float], Array] | None = None
    ) -> None:
        """Refuse a motion that the robot cannot make from joints at `start` (n,).

        Args:
            controller: its model and limits are what the motion is tried on.
            start: joints to begin from (n,) [rad or m].
            duration: of the motion [s].
            force: (3,) at the tip [N] by the time since the start [s], as far as it is known before.

        Raises:
            Unreachable: the first time at which the tip cannot follow, and the limit that is in the way.
            CtrError: the start pose, or the sweep, is outside the limits.
        """
        if isinstance(self._motion, JointSweepMotion):
            self._motion.check(start, controller.limits)
        elif self._trajectory is not None:
            try:
                check_reach(
                    controller.statics, controller.limits, start, self._trajectory, duration, force,
                    controller.aim, self._directions,
                )  # fmt: skip
            except Unreachable as error:
                said = Unreachable(f"{self._motion.kind} {error}")
                raise said if error.time is None else said.at(error.time) from None

    def at(self, time: float) -> Setpoint | JointMotion:
        """The order at `time` [s] since the motion's start."""
        if self._trajectory is not None:
            setpoint = self._trajectory.setpoint(time)
            return setpoint if self._directions is None else Setpoint(*setpoint[:2], *self._directions.at(time))
        return JointMotion(self._sweep if time < self._sweep_end else np.zeros_like(self._sweep))
