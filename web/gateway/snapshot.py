"""Snapshot of the robot: the newest row of telemetry as one immutable value that every protocol encodes."""

import math
import time
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array, Robot
from station.control.clock import StationClock
from station.control.ring import HEARTBEAT, Ring
from station.control.states import State
from station.control.telemetry import Channels, stale_groups
from station.recording.drawing import Pose, PoseReader, RobotPose

#: Largest age of the newest telemetry row that is subtracted from the wall-clock time when rows are stamped [s].
STALE_AFTER_S = 0.5
#: Largest decrease and largest increase of the estimated clock offset per reading [s]. The decrease may be larger
#: because rows arrive late and never early. Both are small so that time stamps never decrease.
OFFSET_GAIN_DOWN, OFFSET_GAIN_UP = 5e-4, 1e-5
#: Largest plausible jump of the clock offset [s]. A larger one means that the control loop was restarted or the
#: computer's clock was set, so the estimate is initialised again.
MAX_CLOCK_OFFSET_S = 1.0
#: Smallest jump that counts as a set clock if it lasts for the second value [s]; a late reading is shorter.
CLOCK_STEP_S, STEP_LASTS_S = 0.02, 0.5
#: Identity quaternion, sent for the measured and the desired tip, because their channels contain only a position.
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class StationInfo:
    """State of the station, which the station process sends because the telemetry ring does not contain it."""

    state: State = State.OFF
    cause: str = ""  #: why the state is HOLD, STOPPED or FAULT
    gains: tuple[tuple[str, float | str | bool], ...] = ()  #: keys and values of the controller's parameters
    busy: bool = False  #: whether a command `move_*` or `home` of a ROS 2 client has not ended yet
    moves: int = 0  #: number of these commands that were started or refused

    @property
    def text(self) -> str:
        """State of the station and its cause in one line."""
        return f"{self.state.name}: {self.cause}" if self.cause else self.state.name


@dataclass(frozen=True)
class SceneState:
    """State of the robot at one time, in the world frame and SI units; unknown values are None."""

    stamp: int  #: time of the telemetry row [ns] since 1970
    measured: Array | None  #: position of the tip by the tracker (3,) [m]
    estimated: Pose | None  #: pose of the tip by the loaded model
    desired: Array | None  #: desired position of the tip (3,) [m]
    bases: tuple[Pose, ...]  #: pose of each tube's base; empty if the model has no solution
    lines: tuple[Array, ...]  #: centre line of each tube (k, 3) [m]
    force: Array | None  #: estimated force at the tip (3,) [N]
    moment: Array | None  #: measured moment about the plate's origin (3,) [N m]
    row: Array = field(repr=False)  #: values of all telemetry channels
    pose: RobotPose | None = field(repr=False)  #: shape of the robot; None if the model has no solution

    def tips(self) -> dict[str, Pose]:
        """Return the measured, estimated and desired tip by name; unknown tips are omitted."""
        known: dict[str, Pose | None] = {
            "measured": _upright_pose(self.measured),
            "estimated": self.estimated,
            "desired": _upright_pose(self.desired),
        }
        return {name: pose for name, pose in known.items() if pose is not None}


class Snapshot(NamedTuple):
    """Telemetry that was written since the previous reading of the ring."""

    info: StationInfo
    rows: Array  #: telemetry rows (n, channels), newest last; old rows may be missing
    stamps: NDArray[np.int64]  #: time of each row (n,) [ns] since 1970
    scene: SceneState | None  #: None: no current telemetry, or no client needs it


class SnapshotReader:
    """Reader that turns the newest rows of a telemetry ring into a `Snapshot`."""

    def __init__(self, ring: Ring, robot: Robot, channels: Channels, clock: StationClock) -> None:
        self._ring, self._channels, self._clock = ring, channels, clock
        self._poses = PoseReader(robot, channels.all)
        self._next = ring.written
        self._zero: float | None = None  # estimated wall-clock time at which the rows' time was 0 [s] since 1970
        self._far_since = math.inf  # time since which the clock offset has jumped [s]

    def read(self, info: StationInfo, *, with_scene: bool) -> Snapshot:
        """Return the telemetry since the last reading; `with_scene` also solves the model for the robot's shape."""
        rows, self._next, _ = self._ring.read(self._next)
        age = self._clock.now() - float(self._ring.numbers[HEARTBEAT])
        if not len(rows):
            return Snapshot(info, rows, np.empty(0, np.int64), None)
        # The wall-clock time of the newest row is that of the control loop's last heartbeat, when the row was written.
        newest, rate = time.time() - self._clock.real(min(max(age, 0.0), STALE_AFTER_S)), self._clock.rate
        zero = newest - float(rows[-1, 0]) / rate
        now, step = self._clock.now(), math.inf if self._zero is None else abs(zero - self._zero)
        self._far_since = math.inf if step <= CLOCK_STEP_S else min(self._far_since, now)
        if self._zero is None or step > MAX_CLOCK_OFFSET_S or now - self._far_since > STEP_LASTS_S:
            self._zero = zero
        self._zero += min(max(zero - self._zero, -OFFSET_GAIN_DOWN), OFFSET_GAIN_UP)
        stamps = (1e9 * (self._zero + rows[:, 0] / rate)).astype(np.int64)
        return Snapshot(info, rows, stamps, self._scene(rows[-1], int(stamps[-1])) if with_scene else None)

    def _scene(self, row: Array, stamp: int) -> SceneState:
        of, stale, pose = self._channels.of, stale_groups(self._channels, row), self._poses.of(row)

        def known(group: str) -> Array | None:
            return None if group in stale else of(row, group)

        return SceneState(
            stamp, known("tip_measured"), None if pose is None else pose.tip, known("tip_desired"),
            () if pose is None else pose.bases, () if pose is None else pose.lines,
            known("force"), known("moment"), row, pose,
        )  # fmt: skip


def _upright_pose(position: Array | None) -> Pose | None:
    return None if position is None else (position.tolist(), _UPRIGHT)
