"""A virtual lab whose devices have no flaw: for simulations of the model and the strategies alone.

Real devices cannot be like that, and a line of 9600 baud even less, so these have no bytes: each tick the
stages take every joint's velocity at once, and the sensors show what is.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from core.robot.robot import Array, Robot
from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.devices.interfaces import Condition, Devices, JointReading, TipReading, Trouble, Truth, WrenchReading
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.loads import Load, NoLoad
from station.lab.true_plant import true_plant


class IdealLab:
    """The plant and what pulls at it, without a wire between."""

    trouble = ""  #: the true robot always follows, or `advance` raises

    def __init__(self, robot: RobotFile, config: LabConfig, seed: int, positions: Array) -> None:
        """The joints are at `positions` (n,).

        Raises:
            PoseError, NoSolution: the true robot cannot stand there.
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
        """The robot as it really is."""
        return self._plant.robot

    def true_joints(self, positions: Array) -> Array:
        """Where the joints really are (n,) when the stages count `positions` (n,): there."""
        return positions

    def apply_load(self, load: Load, start: float) -> None:
        """Put a load on the tip whose time counts from `start` [s]."""
        self._load, self._load_start = load, start

    def inject(self, faults: Sequence[LabFault], start: float) -> None:  # noqa: ARG002 - there is no wire to disturb
        """Devices without flaw have no faults.

        Raises:
            ConfigError: some were asked for.
        """
        if faults:
            raise ConfigError("faults: ideal devices have none; use a lab with devices = 'wire'")

    def advance(self, now: float) -> Truth:
        """Let time pass until `now` [s].

        Raises:
            PoseError, NoSolution: the true robot cannot stand so.
        """
        self._stages.advance(now)
        force = self._load.force(now - self._load_start)
        truth, wrenches = self._plant.advance(self._stages.positions, force, now=now)
        self._tracker.direction = truth.direction
        self._tracker.tip, self._sensors.reading = truth.tip, WrenchReading(now, wrenches)
        return truth


class _Faultless:
    """What needs no connecting and never fails."""

    condition = Condition.CONNECTED
    ready = True

    def connect(self, now: float) -> None:
        """Nothing to do: an ideal device is always connected."""

    def home(self, now: float) -> None:
        """Nothing to do: ideal stages know where they are."""

    def trouble(self, now: float) -> Trouble | None:  # noqa: ARG002 - never
        """None."""
        return None

    def details(self) -> Mapping[str, Any]:
        """None."""
        return {}

    def close(self) -> None:
        """Nothing is open."""


class IdealStages(_Faultless):
    """Motors that run at the velocity they were told, from the moment they were told, to the end of travel."""

    def __init__(self, robot: RobotFile, positions: Array) -> None:
        self.positions = positions.copy()  #: (n,) [rad or m]
        self._lower = np.array([joint.lower for joint in robot.joints])
        self._upper = np.array([joint.upper for joint in robot.joints])
        self._speed = np.array([joint.speed for joint in robot.joints])
        self._velocity = np.zeros(len(robot.joints))
        self._time = 0.0

    def poll(self, now: float) -> JointReading:  # noqa: ARG002 - the lab has moved to `now` already
        """Where they are."""
        return JointReading(self.positions.copy(), self._velocity.copy())

    def command(self, velocities: Array, now: float) -> None:  # noqa: ARG002 - at once
        """Take velocities (n,)."""
        self._velocity = np.minimum(np.maximum(velocities, -self._speed), self._speed)

    def stop(self, now: float) -> None:  # noqa: ARG002 - at once
        """Stand still."""
        self._velocity = np.zeros_like(self._velocity)

    def advance(self, now: float) -> None:
        """Run until `now` [s]."""
        there = self.positions + (now - self._time) * self._velocity
        self.positions, self._time = np.minimum(np.maximum(there, self._lower), self._upper), now


class IdealTracker(_Faultless):
    """Frames without noise and delay."""

    def __init__(self, rate: float) -> None:
        self.tip = np.zeros(3)  #: the true one [m]
        self.direction: Array | None = None  #: (3,) the true one
        self._rate, self._frame = rate, -1

    def poll(self, now: float) -> TipReading | None:
        """The frame of `now`, if there is one."""
        frame = int(now * self._rate + 1e-6)
        if frame == self._frame:
            return None
        self._frame = frame
        return TipReading(frame, now, self.tip.copy(), direction=self.direction)


class IdealSensors(_Faultless):
    """What the bases feel."""

    reading: WrenchReading

    def poll(self, now: float) -> WrenchReading:  # noqa: ARG002 - the lab has moved to `now` already
        """The wrenches of now."""
        return self.reading
