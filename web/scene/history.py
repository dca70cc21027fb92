"""Recent telemetry for the scene: the trace of the tip, and which values are current.

A telemetry row has all channels, but the values of a silent device or of a lost target are stale.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.control.follow import TARGET_LOST_S
from station.control.ring import Ring
from station.control.telemetry import Channels
from station.devices.interfaces import ABSENT, Severity
from station.service.status import STALE_AFTER_S, StationStatus


class TargetVisibility:
    """Detector of a visible target; it must receive all rows of telemetry.

    The target's channels do not show a loss of the target, because they keep their last values.
    """

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._seen = -np.inf  # time of the last measurement of the target, by the time of the rows [s]

    def update(self, rows: Array) -> bool:
        """Return whether the target's last measurement is younger than `TARGET_LOST_S`, given the new `rows`."""
        times = self._channels.of(rows, "time")[:, 0]
        new = self._channels.of(rows, "target_new")[:, 0] > 0.0
        now = float(times[-1])
        if new.any():
            self._seen = float(times[new][-1])
        elif self._seen > now:
            self._seen = -np.inf  # the control process has restarted, because the time of the rows decreased
        return now - self._seen <= TARGET_LOST_S


TRACE_SPAN_S = 20.0  #: duration of the drawn trace of the tip [s]
TRACE_BIN_S = 0.1  #: time over which one point of the trace is averaged [s]


class TracePoint(NamedTuple):
    """Point of the trace: mean of the telemetry over one interval of `TRACE_BIN_S`."""

    time: float  #: centre of the interval [s]
    tip: Array  #: mean of the measured tip (3,) [m]


class TipTrace:
    """Recent telemetry that the scene reads from the ring: the trace of the tip, and the newest rows."""

    def __init__(self, channels: Channels) -> None:
        self.points: deque[TracePoint] = deque(maxlen=round(TRACE_SPAN_S / TRACE_BIN_S))
        self.recent = np.empty((0, len(channels)))  #: telemetry rows of the last `TRACE_BIN_S`, newest last
        self.measured = -np.inf  #: time of the newest row that contains a new measurement of the tip [s]
        self.target_visible = False  #: whether the tracker measures a moving target now
        self._channels = channels
        self._target = TargetVisibility(channels)
        self._next = 0
        self._open = self.recent

    def read(self, ring: Ring) -> None:
        """Read the telemetry rows that were written since the last call.

        If the time of the rows decreases, the control process has restarted, and a new trace is started.
        """
        rows, self._next, _ = ring.read(self._next)
        if len(rows):
            self.take(rows)

    def take(self, rows: Array) -> None:
        """Add telemetry `rows` (n, channels)."""
        of = self._channels.of
        self.target_visible = self._target.update(rows)
        times = of(rows, "time")[:, 0]
        backward = np.flatnonzero(np.diff(times, prepend=self.now) < 0.0)
        if len(backward):
            rows, times = rows[backward[-1] :], times[backward[-1] :]
            self.points.clear()
            self.measured = -np.inf
            self.recent, self._open = self.recent[:0], self.recent[:0]
        new = of(rows, "tip_new")[:, 0] > 0.0
        if new.any():
            self.measured = float(times[new][-1])
        self.recent = np.concatenate((self.recent, rows))
        self.recent = self.recent[of(self.recent, "time")[:, 0] > times[-1] - TRACE_BIN_S]
        self._open = np.concatenate((self._open, rows))
        numbers = np.floor(of(self._open, "time")[:, 0] / TRACE_BIN_S + 1e-6)
        *closed, self._open = np.split(self._open, np.flatnonzero(np.diff(numbers)) + 1)
        self.points.extend(
            TracePoint(float(of(part, "time")[0, 0]) + 0.5 * TRACE_BIN_S, of(part, "tip_measured").mean(axis=0))
            for part in closed
            if of(part, "tip_new").any()  # an interval without a measurement of the tip has no point
        )

    @property
    def now(self) -> float:
        """Time of the newest telemetry row [s]; 0 before the first."""
        return float(self._channels.of(self.recent[-1], "time")[0]) if len(self.recent) else 0.0

    @property
    def trace(self) -> Array:
        """Measured tip in the last `TRACE_SPAN_S`, oldest first (k, 3) [m]."""
        tips = [point.tip for point in self.points if point.time > self.now - TRACE_SPAN_S]
        return np.array(tips).reshape(-1, 3)

    def group(self, name: str) -> Array:
        """Return the values of a channel group over the last `TRACE_BIN_S` (n, ...)."""
        return self._channels.of(self.recent, name)

    def mean(self, group: str) -> Array:
        """Return the mean of a channel group over the last `TRACE_BIN_S`, which reduces noise in the picture."""
        return self.group(group).mean(axis=0)


#: Age from which a measured tip is stale [s]; the control loop has the same timeout for the tracker.
MAX_TIP_AGE_S = 0.25


class Validity(NamedTuple):
    """Which values of the newest telemetry row are current."""

    row: bool  #: whether the control loop writes telemetry
    joints: bool  #: whether the stages answer
    tip: bool  #: whether the tracker measures the tip
    force: bool  #: whether the force on the tip is known
    absent: frozenset[str] = frozenset()  #: values that this rig does not measure at all

    @property
    def message(self) -> str:
        """Text that lists the stale values; empty if all are current."""
        parts = {"joints": self.joints, "tip": self.tip, "force": self.force}
        missing = [name for name, known in parts.items() if not known and name not in self.absent]
        return f"not measured now: {', '.join(missing)}" if missing else ""


NOTHING = Validity(row=False, joints=False, tip=False, force=False)


def validity_of(status: StationStatus, history: TipTrace) -> Validity:
    """Return the validity of the newest telemetry row."""
    if not status.values or status.age > STALE_AFTER_S or len(history.recent) == 0:
        return NOTHING
    _, tracker, sensors = status.values["trouble"] == ABSENT
    return Validity(
        row=True,
        joints=bool(status.values["trouble"][0] < Severity.HOLD),
        tip=history.now - history.measured <= MAX_TIP_AGE_S,  # not every row has a new frame
        force="force" not in status.stale_groups,
        absent=frozenset({"tip"} if tracker else ()) | ({"force"} if tracker and sensors else frozenset()),
    )
