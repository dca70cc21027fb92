"""What the gateway shows of the robot: the newest row as one frozen value, from which every protocol encodes."""

import time
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array, Robot
from station.control.clock import StationClock
from station.control.ring import HEARTBEAT, Ring
from station.control.states import State
from station.control.telemetry import Channels
from station.recording.posed import Pose, Posed, Poser
from station.service.standing import standing

#: Telemetry older than this is not shown as if it were of now [s].
STALE = 0.5
#: What the rows' time and the computer's are apart is followed so far with each look, to less and to more: rows come
#: late and never early, and no row's stamp is before that of the row before it [s].
SOONER, LATER = 5e-4, 1e-5
#: Beyond this another loop counts, or the computer's clock was set [s].
APART = 1.0
#: Where the channels do not tell: the measured and the desired tip have a place and no direction.
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Told:
    """What the ring does not have; the station process tells it."""

    state: State = State.OFF
    cause: str = ""  #: why it is HOLD, STOPPED or FAULT
    gains: tuple[tuple[str, float | str | bool], ...] = ()  #: of the controller, by name

    @property
    def text(self) -> str:
        """State and cause in a line."""
        return f"{self.state.name}: {self.cause}" if self.cause else self.state.name


@dataclass(frozen=True)
class Seen:
    """The robot at one moment. World frame, metres, newtons, radians; None for what is not known now."""

    time: float  #: as the rows have it [s]
    stamp: int  #: the same moment [ns] since 1970
    state: State
    cause: str
    joints: Array  #: (n,) [rad or m]
    velocities: Array  #: (n,) as sent to the stages
    measured: Array | None  #: tip (3,) [m], the tracker's
    estimated: Pose | None  #: tip, the model's
    desired: Array | None  #: tip (3,) [m]
    bases: tuple[Pose, ...]  #: of each tube; empty without a shape
    lines: tuple[Array, ...]  #: centre line of each tube (k, 3) [m]
    force: Array | None  #: at the tip (3,) [N]
    moment: Array | None  #: about the plate's origin (3,) [N m]
    row: Array = field(repr=False)  #: all of it
    posed: Posed | None = field(repr=False)  #: the whole shape

    def tips(self) -> dict[str, Pose]:
        """Those that are known, by name."""
        known: dict[str, Pose | None] = {
            "measured": _place(self.measured),
            "estimated": self.estimated,
            "desired": _place(self.desired),
        }
        return {name: pose for name, pose in known.items() if pose is not None}


class Look(NamedTuple):
    """What has come since the look before."""

    told: Told
    rows: Array  #: (n, channels), the newest last; old ones may have been missed
    stamps: NDArray[np.int64]  #: of each (n,) [ns] since 1970
    seen: Seen | None  #: None: nothing that is of now, or nobody wants it


class Eyes:
    """One reader of a ring."""

    def __init__(self, ring: Ring, robot: Robot, channels: Channels, clock: StationClock) -> None:
        self._ring, self._channels, self._clock = ring, channels, clock
        self._poser = Poser(robot, channels.all)
        self._next = ring.written
        self._zero: float | None = None  # when the rows' time was 0 [s] since 1970

    def look(self, told: Told, *, wanted: bool) -> Look:
        """What has come since the last time; the robot in it only if that is `wanted`, it takes a solution."""
        rows, self._next, _ = self._ring.read(self._next)
        age = self._clock.now() - float(self._ring.numbers[HEARTBEAT])
        if not len(rows):
            return Look(told, rows, np.empty(0, np.int64), None)
        # The newest was written when the loop showed last that it lives.
        newest, rate = time.time() - self._clock.real(min(max(age, 0.0), STALE)), self._clock.rate
        zero = newest - float(rows[-1, 0]) / rate
        if self._zero is None or abs(zero - self._zero) > APART:
            self._zero = zero
        self._zero += min(max(zero - self._zero, -SOONER), LATER)
        stamps = (1e9 * (self._zero + rows[:, 0] / rate)).astype(np.int64)
        return Look(told, rows, stamps, self._seen(rows[-1], int(stamps[-1]), told) if wanted else None)

    def _seen(self, row: Array, stamp: int, told: Told) -> Seen:
        of, old, posed = self._channels.of, standing(self._channels, row), self._poser.of(row)

        def known(group: str) -> Array | None:
            return None if group in old else of(row, group)

        return Seen(
            float(row[0]), stamp, told.state, told.cause, of(row, "joints"), of(row, "velocity_sent"),
            known("tip_measured"), None if posed is None else posed.tip, known("tip_desired"),
            () if posed is None else posed.bases, () if posed is None else posed.lines,
            known("force"), known("moment"), row, posed,
        )  # fmt: skip


def _place(position: Array | None) -> Pose | None:
    return None if position is None else (position.tolist(), _UPRIGHT)
