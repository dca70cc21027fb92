"""Motions as people write them, in files and over REST: checked here, carried out by `core.trajectories`."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from core.errors import DescriptionError
from core.robot import Robot
from core.trajectories import Circle, Hold, JointMotion, Setpoint, Sinusoid, Trajectory
from station.config import Positive, Strict, Vector


class HoldMotion(Strict):
    """Keep the tip where it is."""

    kind: Literal["hold"] = "hold"

    def trajectory(self) -> Trajectory:
        """What the controller follows."""
        return Hold()


class SinusoidMotion(Strict):
    """Move the tip back and forth along a line."""

    kind: Literal["sinusoid"] = "sinusoid"
    direction: Vector = (0.0, 0.0, 1.0)
    """world frame; its length does not matter"""
    amplitude: Annotated[float, Field(gt=0.0, le=0.1)]
    """[m]"""
    frequency: Annotated[float, Field(gt=0.0, le=5.0)]
    """[Hz]"""

    @field_validator("direction")
    @classmethod
    def _has_length(cls, direction: Vector) -> Vector:
        return _direction(direction)

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
    normal: Vector = (0.0, 0.0, 1.0)
    """axis of the circle, world frame"""

    @field_validator("normal")
    @classmethod
    def _has_length(cls, normal: Vector) -> Vector:
        return _direction(normal)

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
            self._sweep_end = motion.distance / abs(motion.speed) if motion.speed else 0.0
        else:
            self._trajectory = motion.trajectory()

    def at(self, time: float) -> Setpoint | JointMotion:
        """The order at `time` [s] since the motion's start."""
        if self._trajectory is not None:
            return self._trajectory.setpoint(time)
        return JointMotion(self._sweep if time < self._sweep_end else np.zeros_like(self._sweep))


def _direction(direction: Vector) -> Vector:
    if float(np.linalg.norm(direction)) < 1e-9:
        raise ValueError("a direction needs one component that is not 0")
    return direction
