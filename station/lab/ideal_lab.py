"""A virtual lab with ideal devices, for simulations of the model and the strategies alone.

These devices have no wires. In each tick the stages accept every joint's velocity at once, and the sensors report the
true values.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from core.robot.robot import Array, Robot
from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.devices.interfaces import (
    Condition,
    DeviceFault,
    Devices,
    GroundTruth,
    JointReading,
    TipReading,
    WrenchReading,
)
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.loads import Load, NoLoad, force_of
from station.lab.true_plant import true_plant


class IdealLab:
    """The plant with its load and ideal devices, which have no wires."""

    trouble = ""  #: always empty: the plant (simulated real robot) follows, or `advance` raises

    def __init__(self, robot: RobotFile, config: LabConfig, seed: int, positions: Array) -> None:
        """Create the lab with the joints at `positions` (n,).

        Raises:
            PoseError, NoSolution: the plant (simulated real robot) has no shape there.
        """
        self._plant = true_plant(robot.robot(), config.plant, np.random.default_rng(seed), positions)
        self._stages = IdealStages(robot, positions)
        self._tracker = IdealTracker(config.tracker.rate)
        self._sensors = IdealSensors()
        self._load: Load = NoLoad()
        self._load_start = 0.0
        self.devices = Devices(self._stages, self._tracker, self._sensors)
        self.advance(0.0)

    @property
    def true_robot(self) -> Robot:
        """The robot with its true parameters."""
        return self._plant.robot

    def true_joints(self, positions: Array) -> Array:
        """Return the true joints (n,) when the stages count `positions` (n,): they are equal in an ideal lab."""
        return positions

    def apply_load(self, load: Load, start: float) -> None:
        """Apply a load to the tip; its time counts from `start` [s]."""
        self._load, self._load_start = load, start

    def inject(self, faults: Sequence[LabFault], start: float) -> None:  # noqa: ARG002 - there are no wires
        """Refuse faults: ideal devices have none.

        Raises:
            ConfigError: faults were requested.
        """
        if faults:
            raise ConfigError("faults: ideal devices have none; use a lab with devices = 'wire'")

    def advance(self, now: float) -> GroundTruth:
        """Advance the simulation until `now` [s].

        Raises:
            PoseError, NoSolution: the plant (simulated real robot) has no shape.
        """
        self._stages.advance(now)
        force = force_of(self._load, now - self._load_start)
        truth, wrenches = self._plant.advance(self._stages.positions, force, now=now)
        self._tracker.direction = truth.direction
        self._tracker.tip, self._sensors.reading = truth.tip, WrenchReading(now, wrenches)
        return truth


class _Faultless:
    """Base of devices that are always connected and never fail."""

    condition = Condition.CONNECTED
    ready = True

    def connect(self, now: float) -> None:
        """Nothing to do: an ideal device is always connected."""

    def home(self, now: float) -> None:
        """Nothing to do: ideal stages are always homed."""

    def trouble(self, now: float) -> DeviceFault | None:  # noqa: ARG002 - never
        """Return None, because an ideal device has no faults."""
        return None

    def details(self) -> Mapping[str, Any]:
        """Return an empty mapping, because an ideal device has no identity and no counters."""
        return {}

    def close(self) -> None:
        """Nothing to do: an ideal device has no ports."""


class IdealStages(_Faultless):
    """Motors that run at the commanded velocity without delay, up to the end of the travel."""

    def __init__(self, robot: RobotFile, positions: Array) -> None:
        self.positions = positions.copy()  #: (n,) [rad or m]
        self._lower = np.array([joint.lower for joint in robot.joints])
        self._upper = np.array([joint.upper for joint in robot.joints])
        self._speed = np.array([joint.speed for joint in robot.joints])
        self._velocity = np.zeros(len(robot.joints))
        self._time = 0.0

    def poll(self, now: float) -> JointReading:  # noqa: ARG002 - the lab has moved to `now` already
        """Return positions and velocities."""
        return JointReading(self.positions.copy(), self._velocity.copy())

    def command(self, velocities: Array, now: float) -> None:  # noqa: ARG002 - at once
        """Set the velocities (n,)."""
        self._velocity = np.minimum(np.maximum(velocities, -self._speed), self._speed)

    def stop(self, now: float) -> None:  # noqa: ARG002 - at once
        """Stop all joints."""
        self._velocity = np.zeros_like(self._velocity)

    def advance(self, now: float) -> None:
        """Move the joints until `now` [s]."""
        reached = self.positions + (now - self._time) * self._velocity
        self.positions, self._time = np.minimum(np.maximum(reached, self._lower), self._upper), now


class IdealTracker(_Faultless):
    """Frames without noise and delay."""

    def __init__(self, rate: float) -> None:
        self.tip = np.zeros(3)  #: true position [m]
        self.direction: Array | None = None  #: (3,) true direction
        self._rate, self._frame = rate, -1

    def poll(self, now: float) -> TipReading | None:
        """Return the frame at `now`, if there is a new one."""
        frame = int(now * self._rate + 1e-6)
        if frame == self._frame:
            return None
        self._frame = frame
        return TipReading(frame, now, self.tip.copy(), direction=self.direction)


class IdealSensors(_Faultless):
    """Base sensors that report the true wrenches."""

    reading: WrenchReading

    def poll(self, now: float) -> WrenchReading:  # noqa: ARG002 - the lab has moved to `now` already
        """Return the present wrenches."""
        return self.reading
