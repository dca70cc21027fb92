"""Motions as people write them, in files and over REST: checked here, carried out by `core.trajectories`."""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from core.errors import DescriptionError
from core.limits import Limits
from core.robot import Array, Robot
from core.trajectories import Circle, Hold, JointMotion, Setpoint, Sinusoid, Trajectory
from station.config import Direction, Positive, Strict


class HoldMotion(Strict):
    """Keep the tip where it is."""

    kind: Literal["hold"] = "hold"

    def trajectory(self) -> Trajectory:
        """What the controller follows."""
        return Hold()


class SinusoidMotion(Strict):
    """Move the tip back and forth along a line."""

    kind: Literal["sinusoid"] = "sinusoid"
    direction: Direction = (0.0, 0.0, 1.0)
    amplitude: Annotated[float, Field(gt=0.0, le=0.1)]
    """[m]"""
    frequency: Annotated[float, Field(gt=0.0, le=5.0)]
    """[Hz]"""

    def trajectory(self) -> Trajectory:
        """What the controller follows."""
        return Sinusoid(self.direction, self.amplitude, self.frequency)


class CircleMotion(Strict):
    """Move the tip along a circle through its start."""

    kind: Literal["circle"] = "circle"
    radius: Annotated[float, Field(gt=0.0, le=0.1)]
    """[m]"""
    period: Annotated[float, Field(ge=0.2, le=3600.0)]
    """[s]"""
    normal: Direction = (0.0, 0.0, 1.0)
    """axis of the circle"""

    def trajectory(self) -> Trajectory:
        """What the controller follows."""
        return Circle(self.radius, self.period, self.normal)


class JointSweepMotion(Strict):
    """Turn or slide one joint at constant speed; the tip is not controlled."""

    kind: Literal["joint_sweep"] = "joint_sweep"
    joint: str
    speed: float
    """[rad/s or m/s]; negative the other way"""
    distance: Positive
    """[rad or m]"""

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


TipMotion = HoldMotion | SinusoidMotion | CircleMotion
Motion = Annotated[TipMotion | JointSweepMotion, Field(discriminator="kind")]


class Orders:
    """What the controller is told at each moment of a motion."""

    def __init__(self, motion: TipMotion | JointSweepMotion, robot: Robot) -> None:
        """Raises DescriptionError when the robot has no such joint."""
        self._trajectory: Trajectory | None = None
        if isinstance(motion, JointSweepMotion):
            if motion.joint not in robot.joint_names:
                raise DescriptionError(f"joint_sweep: '{motion.joint}' is not one of {', '.join(robot.joint_names)}")
            self._sweep = np.zeros(len(robot.joints))
            self._sweep[robot.joint_names.index(motion.joint)] = motion.speed
            self._sweep_end = motion.distance / abs(motion.speed)
        else:
            self._trajectory = motion.trajectory()

    def at(self, time: float) -> Setpoint | JointMotion:
        """The order at `time` [s] since the motion's start."""
        if self._trajectory is not None:
            return self._trajectory.setpoint(time)
        return JointMotion(self._sweep if time < self._sweep_end else np.zeros_like(self._sweep))
