"""The channels of a run: one row of numbers a tick, the same for recordings and live views."""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.control.estimation import NEWEST, USED, VECTORS, known_of
from core.control.leading import Wish
from core.control.pointing import Pointed
from core.control.step import Tick
from core.model.solution import PASSES, STABILITY, parts
from core.robot.robot import Array, Robot
from station.control.led import Asked
from station.control.states import State
from station.devices.interfaces import JointReading, TipReading, Truth, WrenchReading

XYZ = ("x", "y", "z")
#: Columns of the tip's direction, and of a target, the last ones.
DIRECTION, TARGET = 12, 14


class Channel(NamedTuple):
    """One named column of every row."""

    name: str
    unit: str

    @property
    def column(self) -> str:
        """Name with the unit, as in file headers."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Channels:
    """Names, units and places of all columns for one robot."""

    def __init__(self, robot: Robot) -> None:
        self.all: tuple[Channel, ...] = tuple(_channels(robot))
        self._at: dict[str, slice] = {}
        self._width = len(self.all)
        names = [channel.name for channel in self.all]
        groups = [name.rsplit(".", 1)[0] for name in names]
        for group in dict.fromkeys(groups):
            self._at[group] = slice(groups.index(group), groups.index(group) + groups.count(group))

    def __len__(self) -> int:
        return len(self.all)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names that `of` takes."""
        return tuple(self._at)

    def of(self, rows: Array, group: str) -> Array:
        """The columns of a group, e.g. `tip_measured`: (..., 3)."""
        return rows[..., self._at[group]]

    def row(
        self,
        time: float,
        state: State,
        phase: int,
        joints: JointReading,
        wrenches: WrenchReading,
        frame: TipReading | None,
        tick: Tick,
        truth: Truth | None,
        troubles: tuple[int, int, int] = (0, 0, 0),
        asked: Asked | None = None,
        target: Array | None = None,
    ) -> Array:
        """One tick as numbers, in the order of `all`.

        Between tracker frames `tip_new` is 0 and the last frame's values stand. Without a virtual
        lab nothing is known to be true: `truth_known` is 0 and the true channels are 0. `phase` is what the
        run is doing, as `task.Phase` numbers it, 0 without one; `troubles` are the severities of what is
        wrong with stages, tracker and force sensors, 0 where nothing is. Of a tip that is led, `asked` is where it
        was last asked to be (`asked_kind` 1) or at which velocity (2), and when; `target` (14,) is what is known of
        a target, 0 without.
        """
        memory, now = tick.memory, tick.memory.estimate
        true_tip, true_force, *_ = truth or _UNKNOWN
        new, frame_time = (False, 0.0) if frame is None else (True, frame.time)
        stages, tracker, sensors = troubles
        wish = _NOTHING if asked is None or asked.wish is None else asked.wish
        kind = 0 if wish is _NOTHING else 1 if wish.place is not None else 2
        place = memory.origin + wish.place if wish.place is not None else _NOWHERE
        row = np.empty(self._width)
        _fill(
            row, time, int(state), int(phase), new, frame_time, stages, tracker, sensors, truth is not None,
            true_tip, true_force,
            joints.positions, tick.command, joints.sent, wrenches.wrenches, tick.load.force, tick.load.moment,
            memory.tip, now.loaded.numbers, now.unloaded.numbers, memory.origin, tick.setpoint.position,
            tick.u_int, tick.sigma, tick.at_bound, now.numbers,
            kind, wish.asked, place, wish.velocity,
        )  # fmt: skip
        row[-TARGET:] = 0.0 if target is None else target
        directions = row[-TARGET - DIRECTION : -TARGET]  # measured, observed, desired, true; 0 of what is not known
        directions[:] = 0.0
        if memory.pointed is not None:
            _point(directions, tick, memory.pointed)
        if truth is not None and truth.direction is not None:
            directions[9:] = truth.direction
        return row

    def held(
        self,
        last: Array,
        time: float,
        state: State,
        phase: int,
        joints: JointReading,
        wrenches: WrenchReading,
        troubles: tuple[int, int, int] = (0, 0, 0),
    ) -> Array:
        """The last row with what was read since, `held`: the controller has nothing new to say."""
        row = last.copy()
        row[0], row[1], row[2], row[3] = time, state, phase, 1.0
        if np.isfinite(joints.positions).all():
            self.of(row, "joints")[:] = joints.positions
        self.of(row, "velocity_commanded")[:] = 0.0
        if np.isfinite(joints.sent).all():
            self.of(row, "velocity_sent")[:] = joints.sent
        if np.isfinite(wrenches.wrenches).all():
            self.of(row, "wrench_raw")[:] = wrenches.wrenches.ravel()
        self.of(row, "tip_new")[:] = self.of(row, "target_new")[:] = 0.0
        self.of(row, "trouble")[:] = troubles
        return row


def _point(directions: Array, tick: Tick, pointed: Pointed) -> None:
    """Put the tip's direction as measured, observed and desired into (12,)."""
    wanted = tick.setpoint.direction
    directions[:3] = pointed.measured if pointed.seen else 0.0
    directions[3:6] = pointed.observed
    directions[6:9] = pointed.origin if wanted is None else wanted


_NOWHERE = np.zeros(3)
_NOTHING = Wish(None, np.zeros(3), 0.0, 0.0)
_UNKNOWN = Truth(np.zeros(3), np.zeros(3))


@compiled
def _fill(
    row: Array, time: float, state: int, phase: int, new: bool, frame_time: float,
    stages: int, tracker: int, sensors: int, known: bool, true_tip: Array, true_force: Array,
    positions: Array, command: Array, sent: Array, wrenches: Array, force: Array, moment: Array,
    tip: Array, loaded: Array, unloaded: Array, origin: Array, setpoint: Array,
    u_int: Array, sigma: Array, at_bound: Array, estimate: Array,
    asked_kind: int, asked_time: float, asked: Array, asked_velocity: Array,
) -> None:  # fmt: skip
    """One row in the order of `_channels`; a call of numpy for each part would take longer than the model."""
    row[0], row[1], row[2], row[3], row[4], row[5] = time, state, phase, 0.0, new, frame_time
    row[6], row[7], row[8], row[9] = loaded[PASSES], unloaded[PASSES], estimate[USED], loaded[STABILITY]
    row[10], row[11], row[12], row[13] = stages, tracker, sensors, known
    shape, free, now, at, n = parts(loaded), parts(unloaded), known_of(estimate), 14, positions.shape[0]
    newest = now.tips[int(estimate[NEWEST])]
    for k in range(3):
        row[at + k], row[at + 3 + k] = true_tip[k], true_force[k]
    at += 6
    for j in range(n):
        row[at + j], row[at + n + j], row[at + 2 * n + j] = positions[j], command[j], sent[j]
    at += 3 * n
    for i in range(wrenches.shape[0]):
        for k in range(6):
            row[at + 6 * i + k] = wrenches[i, k]
    at += 6 * wrenches.shape[0]
    for k in range(3):
        row[at + k], row[at + 3 + k], row[at + 6 + k] = force[k], moment[k], tip[k]
        row[at + 9 + k], row[at + 12 + k], row[at + 15 + k] = shape.tip[k], free.tip[k], origin[k] + setpoint[k]
        row[at + 18 + k], row[at + 21 + k] = u_int[k], now.velocity_observed[k] - u_int[k]
    at += 24
    for k in range(sigma.shape[0]):
        row[at + k] = sigma[k]
    at += sigma.shape[0]
    for j in range(n):
        row[at + j] = at_bound[j]
    at += n
    for k in range(3):
        row[at + k] = newest[k] + now.bias[k]
    for i in range(now.vectors.shape[0]):
        for k in range(3):
            row[at + 3 + 3 * i + k] = now.vectors[i, k]
    at += 3 + 3 * now.vectors.shape[0]
    row[at], row[at + 1] = asked_kind, asked_time
    for k in range(3):
        row[at + 2 + k], row[at + 5 + k] = asked[k], asked_velocity[k]


def _channels(robot: Robot) -> list[Channel]:
    def vector(group: str, unit: str) -> list[Channel]:
        return [Channel(f"{group}.{axis}", unit) for axis in XYZ]

    def joints(group: str, per: str = "") -> list[Channel]:
        return [Channel(f"{group}.{joint.name}", joint.unit + per) for joint in robot.joints]

    raw = [
        Channel(f"wrench_raw.{tube.name}_{kind}{axis}", unit)
        for tube in robot.tubes
        for kind, unit in (("f", "N"), ("m", "N m"))
        for axis in XYZ
    ]
    sigma = [Channel(f"sigma.{number}", "m/s") for number in range(1, min(3, len(robot.joints)) + 1)]
    return [
        Channel("time", "s"),
        Channel("state", ""),
        Channel("phase", ""),
        Channel("held", ""),
        Channel("tip_new", ""),
        Channel("tip_time", "s"),
        Channel("passes.loaded", ""),
        Channel("passes.unloaded", ""),
        Channel("observer_used", ""),
        Channel("stability", ""),
        *[Channel(f"trouble.{device}", "") for device in ("stages", "tracker", "sensors")],
        Channel("truth_known", ""),
        *vector("tip_true", "m"),
        *vector("force_true", "N"),
        *joints("joints"),
        *joints("velocity_commanded", "/s"),
        *joints("velocity_sent", "/s"),
        *raw,
        *vector("force", "N"),
        *vector("moment", "N m"),
        *vector("tip_measured", "m"),
        *vector("tip_estimated", "m"),
        *vector("tip_unloaded", "m"),
        *vector("tip_desired", "m"),
        *vector("u_int", "m/s"),
        *vector("delta", "m/s"),
        *sigma,
        *[Channel(f"at_bound.{joint.name}", "") for joint in robot.joints],
        *vector("tip_observed", "m"),
        *[channel for name, unit in VECTORS.items() for channel in vector(name, unit)],
        Channel("bias_covariance.bias", "m^2"),
        Channel("bias_covariance.both", "m^2/s"),
        Channel("bias_covariance.drift", "m^2/s^2"),
        Channel("asked_kind", ""),
        Channel("asked_time", "s"),
        *vector("asked", "m"),
        *vector("asked_velocity", "m/s"),
        *vector("direction_measured", ""),
        *vector("direction_observed", ""),
        *vector("direction_desired", ""),
        *vector("direction_true", ""),
        Channel("target_new", ""),
        Channel("target_followed", ""),
        *vector("target_measured", "m"),
        *vector("target_predicted", "m"),
        *vector("target_offset", "m"),
        *vector("target_true", "m"),
    ]
