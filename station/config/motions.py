"""Motions in files and REST requests; those from `core.control.trajectories` are trajectories themselves."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from core.control.controller_settings import Controller
from core.control.controllers import TYPE_2
from core.control.force_control import Press, without_component
from core.control.palpation import Palpation
from core.control.reachability import check_pose, check_reach
from core.control.trajectories import (
    MAX_WAYPOINTS,
    CircleMotion,
    HelixMotion,
    HoldMotion,
    JointMotion,
    PointedMotion,
    Pressed,
    Setpoint,
    SinusoidMotion,
    StepMotion,
    TimedVectors,
    Trajectory,
    Waypoints,
    directions_of,
)
from core.errors import DescriptionError, Unreachable
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Robot
from station.config.controllers import ControllerFile
from station.config.strict import ConfigError, Direction, Position, Positive, Strict, check, read_text

#: Size that a request with a table of waypoints never exceeds [bytes]: a row of four numbers has at most 106.
MAX_TABLE_BYTES = 110 * MAX_WAYPOINTS
#: Largest file of waypoints [bytes]; it is larger, because a character may have four bytes.
MAX_FILE_BYTES = 4 * MAX_TABLE_BYTES
_REMEDY = "remove waypoints, or divide the motion into several"


class Places(PointedMotion):
    """Waypoints and times as a user has entered them; the tip may be unable to follow them."""

    points: Annotated[TimedVectors, Field(min_length=1, json_schema_extra={"x-max-bytes": MAX_TABLE_BYTES})]
    """time [s] and offset x, y, z from the start tip [m]; the tip reaches the first point at its time"""
    max_speed: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """largest speed of the tip [m/s]"""
    max_acceleration: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """largest acceleration of the tip along the path through the points [m/s^2]"""

    def trajectory(self) -> Waypoints:
        """Return the trajectory that the controller tracks.

        Raises:
            DescriptionError: times do not increase, or the path is too fast; the message names the time.
        """
        times, offsets = tuple(row[0] for row in self.points), tuple(row[1:] for row in self.points)
        return Waypoints(times, offsets, self.max_speed, self.max_acceleration)


class WaypointsMotion(Places):
    """Move smoothly through points at given times, from rest to rest."""

    kind: Literal["waypoints"] = "waypoints"

    @model_validator(mode="after")
    def _possible(self) -> Self:
        try:
            self.trajectory()
        except DescriptionError as error:
            raise ValueError(str(error)) from None
        return self


class FollowMotion(Strict):
    """Keep the tip at an offset from a moving target that carries the tracker's second coil."""

    kind: Literal["follow"] = "follow"
    offset: Position | None = None
    """offset of the tip from the target [m]; default: the offset at the start"""
    predict: bool = True
    """true: track the predicted position of the target, which moves periodically; false: that of the newest frame"""
    lag: Annotated[float, Field(ge=0.0, le=0.2)] = 0.02
    """time from the arrival of a velocity at the stages to the tip's response; the delays of the line are added [s]"""
    max_speed: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """largest speed of the tip [m/s]"""
    max_acceleration: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """largest acceleration of the tip [m/s^2]"""
    patience: Annotated[float, Field(ge=0.25, le=60.0)] = 2.0
    """longest loss of the target [s]; a longer loss ends the run in HOLD"""


class PressMotion(Strict):
    """A motion that presses on an obstacle along a direction."""

    direction: Direction
    """direction in which the tip presses, world frame; its length does not matter"""
    force: Annotated[float, Field(gt=0.0, le=5.0)]
    """force of the tip on the obstacle along the direction [N]"""
    speed: Annotated[float, Field(gt=0.0, le=0.05)] = 0.005
    """largest speed of the approach to the first contact [m/s]. It is also at most 0.5 F c / T, where F is the force, c
    the compliance of the tubes along the direction and T the delay from a contact to the joints (about 0.05 s), so that
    the force at the contact exceeds F by at most a half"""
    reach: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """largest distance of the tip from its start along the direction, forward and backward [m]"""

    @property
    def along(self) -> Array:
        """Direction in which the tip presses (3,), unit vector."""
        return np.array(self.direction) / np.linalg.norm(self.direction)

    @property
    def press(self) -> Press:
        """Largest force of the tip, and the bounds of its motion."""
        return Press(self.along, self.force, self.speed, self.reach)

    def check(self, controller: Controller) -> None:
        """Check that the controller can hold a force.

        Raises:
            DescriptionError: its loops cannot hold a force, or it has a stiffness and would give way to the force.
        """
        laws = controller.strategy.laws
        if laws is None or not laws[0] == laws[1] > 0.0 or laws[3] != TYPE_2 or controller.differentiates:
            raise DescriptionError(
                "a motion that holds a force needs strategy 'dual_layer' with k1 = k2 above 0, inner = 'type_2' and"
                " feedback = 'observer' or 'tracker'"
            )
        if controller.stiffness is not None:
            raise DescriptionError("the motion holds a force, so remove 'stiffness' from the controller")


class ForceMotion(PressMotion):
    """Approach along a direction until contact, then hold a force; across it the tip follows a path or stays."""

    kind: Literal["force"] = "force"
    path: Annotated[CircleMotion | SinusoidMotion | HoldMotion, Field(discriminator="kind")] = HoldMotion()
    """motion across the direction, for instance a circle whose normal is the direction; its part along the direction is
    ignored"""

    def trajectory(self) -> Trajectory:
        """Return the trajectory that the controller tracks."""
        return Pressed(self.path, self.press)


class PalpateMotion(PressMotion):
    """Visit a grid of places in front of an obstacle, and press on each with two forces to measure its stiffness."""

    kind: Literal["palpate"] = "palpate"
    direction: Direction = (0.0, 0.0, 1.0)
    """direction in which the tip presses, world frame; its length does not matter"""
    across: Direction = (1.0, 0.0, 0.0)
    """direction of the grid's rows, world frame; only its part across `direction` counts"""
    columns: Annotated[int, Field(ge=1, le=50)] = 3
    """number of places in a row; the start tip is in front of the middle of the grid"""
    rows: Annotated[int, Field(ge=1, le=50)] = 3
    """number of rows"""
    spacing: Annotated[float, Field(gt=0.0, le=0.05)] = 0.003
    """distance between neighbouring places [m]"""
    light: Annotated[float, Field(gt=0.0, le=5.0)] = 0.05
    """first force of the tip at each place [N]"""
    force: Annotated[float, Field(gt=0.0, le=5.0)] = 0.2
    """second force of the tip at each place, greater than `light` [N]"""
    travel: Annotated[float, Field(ge=0.5, le=60.0)] = 2.0
    """time of the retreat and of the motion to the next place [s]"""
    dwell: Annotated[float, Field(ge=0.5, le=60.0)] = 3.0
    """time for each of the two forces; the first includes the approach, and the second half of each is measured [s]"""

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if not self.force > self.light:
            raise ValueError(f"force {self.force:g} N must be greater than light {self.light:g} N")
        if np.linalg.norm(np.cross(self.across, self.along)) < 1e-3 * np.linalg.norm(self.across):
            raise ValueError(f"across {self.across} is parallel to direction {self.direction}; choose another")
        return self

    @property
    def grid(self) -> tuple[tuple[int, int], ...]:
        """Row and column of each place in the order of the visits: every second row is visited backward."""
        forward = range(self.columns)
        return tuple((row, column) for row in range(self.rows) for column in (forward, forward[::-1])[row % 2])

    def place(self, row: int, column: int) -> Array:
        """Return the offset (3,) of a place of the grid from the start tip [m]."""
        first = without_component(np.array(self.across), self.along)
        first /= np.linalg.norm(first)
        right, up = column - 0.5 * (self.columns - 1), row - 0.5 * (self.rows - 1)
        return self.spacing * (right * first + up * np.cross(self.along, first))

    def trajectory(self) -> Palpation:
        """Return the trajectory that the controller tracks."""
        places = tuple(tuple(self.place(row, column).tolist()) for row, column in self.grid)
        light = self.press._replace(force=self.light)
        return Palpation(places, light, self.press, self.travel, self.dwell)


class CsvMotion(Strict):
    """Waypoints from a CSV file; experiment files may contain this motion, REST requests may not."""

    kind: Literal["csv"] = "csv"
    file: str
    """name of the file, which has the columns time, x, y, z [s, m]"""
    max_speed: Annotated[float, Field(gt=0.0, le=0.1)] = 0.02
    """largest speed of the tip [m/s]"""
    max_acceleration: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """largest acceleration of the tip along the path through the points [m/s^2]"""

    def trajectory(self) -> Trajectory:
        """Return the trajectory that the controller tracks.

        Raises:
            ConfigError: the file cannot be read, is too large, or is not a table of waypoints.
        """
        path = Path(self.file)
        if path.is_file() and (size := path.stat().st_size) > MAX_FILE_BYTES:
            raise ConfigError(f"{path} has {size} bytes; at most {MAX_FILE_BYTES} are read; {_REMEDY}")
        return waypoints_from_csv(read_text(path), self.file, self.max_speed, self.max_acceleration).trajectory()


def waypoints_from_csv(
    text: str, source: str, max_speed: float = 0.02, max_acceleration: float = 0.1
) -> WaypointsMotion:
    """Return waypoints from lines of time, x, y, z [s, m]; a header line and empty lines are skipped.

    Raises:
        ConfigError: too many lines, or a line is not four numbers; the message names the source and the line.
    """
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.replace(",", " ").strip()]
    if lines and lines[0][1].lstrip().lower().startswith("time"):
        del lines[0]
    if len(lines) > MAX_WAYPOINTS:
        raise ConfigError(f"{source}: {len(lines)} waypoints; at most {MAX_WAYPOINTS} are possible; {_REMEDY}")
    points: list[tuple[float, ...]] = []
    for number, line in lines:
        try:
            point = tuple(float(cell) for cell in line.split(","))
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
    """name of the joint"""
    speed: float
    """speed of the joint, at most its speed limit; negative for the opposite direction, not 0 [rad/s or m/s]"""
    distance: Positive
    """distance from the start [rad or m]"""

    @field_validator("speed")
    @classmethod
    def _moves(cls, speed: float) -> float:
        if speed == 0.0:
            raise ValueError("a sweep needs a speed that is not 0")
        return speed

    def check(self, start: Array, statics: Statics, limits: Limits) -> None:
        """Check that joints at `start` (n,) can make the sweep.

        Raises:
            DescriptionError: the sweep is faster than the joint's limit.
            PoseError: the pose at its start or its end violates a limit.
        """
        index = [limit.name for limit in limits.joints].index(self.joint)
        limit = limits.joints[index]
        if abs(self.speed) > limit.speed:
            raise DescriptionError(
                f"joint_sweep: speed {self.speed:g} {limit.unit}/s is outside +-{limit.speed:g} {limit.unit}/s"
            )
        end = start.copy()
        end[index] += math.copysign(self.distance, self.speed)
        # A full turn ends exactly at the end of the travel, but rounding may put it slightly beyond.
        nearest = min(max(end[index], limit.lower), limit.upper)
        if abs(end[index] - nearest) <= 1e-9 * self.distance:
            end[index] = nearest
        for pose in (start, end):
            check_pose(statics, limits, pose)


#: Motions that both files and REST requests may contain.
TipMotion = (
    HoldMotion
    | SinusoidMotion
    | CircleMotion
    | HelixMotion
    | WaypointsMotion
    | StepMotion
    | FollowMotion
    | ForceMotion
    | PalpateMotion
)
Motion = Annotated[TipMotion | CsvMotion | JointSweepMotion, Field(discriminator="kind")]


#: Bandwidth of the filters of force and deflection while the tip holds a force [Hz]. With the usual bandwidths friction
#: in the tubes keeps up an oscillation: it reverses the forces at the sensors, and the loops follow their rate.
#: Palpation keeps the usual bandwidths, because between its two forces the tip must not slide.
PRESS_BANDWIDTH_HZ = 0.3


def suited(file: ControllerFile, motion: Motion) -> ControllerFile:
    """Return the controller's settings for a motion; for a force without a bandwidth add `PRESS_BANDWIDTH_HZ`."""
    if not isinstance(motion, ForceMotion) or file.filter_bandwidth is not None:
        return file
    return file.model_copy(update={"filter_bandwidth": PRESS_BANDWIDTH_HZ})


def trajectory_of(motion: TipMotion | CsvMotion) -> Trajectory:
    """Return the trajectory that the controller tracks.

    Raises:
        ConfigError: the file of waypoints cannot be read, or is not a table of waypoints.
    """
    match motion:
        case FollowMotion():
            return HoldMotion()  # the target's motion is not known in advance
        case WaypointsMotion() | CsvMotion() | ForceMotion() | PalpateMotion():
            return motion.trajectory()
        case _:
            return motion


class Orders:
    """Setpoints or joint velocities for the controller over the time of a motion."""

    def __init__(self, motion: TipMotion | CsvMotion | JointSweepMotion, robot: Robot) -> None:
        """Prepare the orders; raises DescriptionError for an unknown joint, ConfigError for an unreadable file."""
        self._motion = motion
        #: The target determines the desired position; `at` gives the start position only.
        self.follow = motion if isinstance(motion, FollowMotion) else None
        #: Largest desired force of the tip; None: the motion controls the position only.
        self.press = motion.press if isinstance(motion, PressMotion) else None
        self._trajectory: Trajectory | None = None
        self._directions = directions_of(motion.directions) if isinstance(motion, PointedMotion) else None
        if isinstance(motion, JointSweepMotion):
            if motion.joint not in robot.joint_names:
                raise DescriptionError(f"joint_sweep: '{motion.joint}' is not one of {', '.join(robot.joint_names)}")
            self._sweep = np.zeros(len(robot.joints))
            self._sweep[robot.joint_names.index(motion.joint)] = motion.speed
            self._sweep_end = motion.distance / abs(motion.speed)
        else:
            self._trajectory = trajectory_of(motion)

    def check(
        self, controller: Controller, start: Array, duration: float, force: Callable[[float], Array] | None = None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> None:  # fmt: skip
        """Check that the robot can make the motion from joints at `start` (n,).

        Args:
            controller: the check uses its model and limits.
            start: joint positions at the start (n,) [rad or m].
            duration: duration of the motion [s].
            force: function from the time since the start [s] to the known force at the tip (3,) [N].
            cancelled: returns whether the result is no longer required.

        Raises:
            Cancelled: the result is no longer required.
            Unreachable: the tip cannot follow; the message names the first such time and the limit that prevents it.
            CtrError: the start pose or the sweep violates a limit, or a custom loop violates its contract.
        """
        controller.check_loops(start)
        if isinstance(self._motion, PressMotion):
            self._motion.check(controller)
        if isinstance(self._motion, JointSweepMotion):
            self._motion.check(start, controller.statics, controller.limits)
        elif self._trajectory is not None:
            try:
                check_reach(
                    controller.statics, controller.limits, start, self._trajectory, duration, force,
                    controller.aim, self._directions, cancelled,
                )  # fmt: skip
            except Unreachable as error:
                failure = Unreachable(f"{self._motion.kind} {error}")
                raise failure if error.time is None else failure.at(error.time) from None

    def at(self, time: float) -> Setpoint | JointMotion:
        """Return the order at `time` [s] since the motion's start."""
        if self._trajectory is not None:
            setpoint = self._trajectory.setpoint(time)
            return setpoint if self._directions is None else Setpoint(*setpoint[:2], *self._directions.at(time))
        return JointMotion(self._sweep if time < self._sweep_end else np.zeros_like(self._sweep))
