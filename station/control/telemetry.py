"""Channels of telemetry: one row of numbers for each tick, the same for recordings and live views.

A row always has every channel. It repeats the last known values while stages are being homed, lost or reconnected, and
while a device has no valid sample; such values are stale.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.control.estimation import FRAME_USED, NEWEST_INDEX, VECTOR_UNITS, estimate_fields
from core.control.setpoint_request import SetpointRequest
from core.control.step import Tick
from core.control.tip_direction import DirectionEstimate
from core.model.solution import PASSES, STABILITY, fields
from core.robot.robot import Array, Robot
from station.control.states import State
from station.control.task import StreamRequest
from station.devices.interfaces import ABSENT, GroundTruth, JointReading, Severity, TipReading, WrenchReading

XYZ = ("x", "y", "z")


class Channel(NamedTuple):
    """One named column of every telemetry row."""

    name: str
    unit: str

    @property
    def column(self) -> str:
        """Name with the unit, as it appears in the headers of files."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


class Channels:
    """Channels of telemetry for one robot: the names, units and indices of its columns."""

    def __init__(self, robot: Robot) -> None:
        self.all: tuple[Channel, ...] = tuple(_channels(robot))
        self._width = len(self.all)
        groups = [channel.name.rsplit(".", 1)[0] for channel in self.all]
        self._at = {name: slice(groups.index(name), groups.index(name) + groups.count(name)) for name in groups}
        self._target = slice(self._at["target_new"].start, self._at["target_new"].start + TARGET_WIDTH)

    def __len__(self) -> int:
        return len(self.all)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups of channels, which `of` accepts."""
        return tuple(self._at)

    def of(self, rows: Array, group: str) -> Array:
        """Return the columns of a group of channels, for example (..., 3) for `tip_measured`."""
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
        truth: GroundTruth | None,
        troubles: tuple[int, int, int] = (0, 0, 0),
        request: StreamRequest | None = None,
        target: Array | None = None,
        contact_start: float = 0.0,
    ) -> Array:
        """Return the row of one tick: its numbers in the order of the channels in `all`.

        Between tracker frames `tip_new` is 0 and the values of the last frame are repeated. Without a virtual lab there
        is no ground truth: `truth_known` and the true channels are 0. `phase` is a `task.Phase`, 0 without a run.
        `troubles` are the severities of faults of stages, tracker and force sensors: 0 without a fault, `ABSENT`
        without the device; the channels of an absent device have no meaning. Without force sensors the channels
        `FORCE_CHANNELS` are the force from the deflection. `request` is the latest setpoint request
        for a streamed tip: its `request_kind` is 1 for a position and 2 for a velocity. `target` (14,) is from
        `TargetTrack.numbers`; without it the channels of the target are 0. `contact_start` is the time at which a tip
        that holds a force has touched the obstacle [s], 0 without contact. The channels `stiffness` are the present
        stiffness of the tip along the axes of its frame, 0 without a stiffness or without a motion.
        """
        memory, now = tick.memory, tick.memory.estimate
        true_tip, true_force, _, true_direction = truth or _NO_TRUTH
        new, frame_time = (False, 0.0) if frame is None else (True, frame.time)
        stages, tracker, sensors = troubles
        row = np.zeros(self._width)
        _fill(
            row, time, int(state), int(phase), new, frame_time, stages, tracker, sensors, truth is not None,
            true_tip, true_force,
            joints.positions, tick.command, joints.sent, wrenches.wrenches, tick.load.force, tick.load.moment,
            memory.tip, now.loaded.numbers, now.unloaded.numbers, memory.origin, tick.setpoint.position,
            tick.u_int, tick.sigma, tick.at_bound, now.numbers,
            _ZERO if true_direction is None else true_direction,
            *(_NO_DEFLECTION if memory.deflection is None else memory.deflection[:2]), tick.clearance, contact_start,
        )  # fmt: skip
        if request is not None and request.setpoint is not None:
            self._add_request(row, request.setpoint, memory.origin)
        if memory.direction is not None:
            self._add_directions(row, tick, memory.direction)
        if target is not None:
            row[self._target] = target
        if tick.setpoint.stiffness is not None:
            self.of(row, "stiffness")[:] = tick.setpoint.stiffness.axes
        if sensors == ABSENT and memory.deflection is not None:
            self.of(row, "force_filtered")[:] = memory.deflection.force
            self.of(row, "force_variance")[:] = memory.deflection.covariance[[0, 3, 5]]
        return row

    def _add_request(self, row: Array, request: SetpointRequest, origin: Array) -> None:
        """Write the setpoint request of a streaming client to a row; `origin` (3,) is the origin of setpoints [m]."""
        self.of(row, "request_kind")[:] = 1.0 if request.position is not None else 2.0
        self.of(row, "request_time")[:] = request.time
        if request.position is not None:
            self.of(row, "request")[:] = origin + request.position
        self.of(row, "request_velocity")[:] = request.velocity

    def _add_directions(self, row: Array, tick: Tick, known: DirectionEstimate) -> None:
        """Write the measured, observed and desired direction of the tip to a row."""
        desired = tick.setpoint.direction
        if known.measured_once:
            self.of(row, "direction_measured")[:] = known.measured
        self.of(row, "direction_observed")[:] = known.observed
        self.of(row, "direction_desired")[:] = known.origin if desired is None else desired

    def frozen_row(
        self,
        last: Array,
        time: float,
        state: State,
        phase: int,
        joints: JointReading,
        wrenches: WrenchReading,
        troubles: tuple[int, int, int] = (0, 0, 0),
    ) -> Array:
        """Return a copy of the row `last` with new readings, unchanged estimates, and `estimates_frozen` = 1."""
        row = last.copy()
        new = {
            "time": time, "state": state, "phase": phase, "estimates_frozen": 1.0, "tip_new": 0.0, "target_new": 0.0,
            "trouble": troubles, "velocity_commanded": 0.0,
            "joints": joints.positions, "velocity_sent": joints.sent, "wrench_raw": wrenches.wrenches.ravel(),
        }  # fmt: skip
        for group, values in new.items():
            if np.isfinite(values).all():
                self.of(row, group)[:] = values
        return row


_ZERO = np.zeros(3)
_NO_TRUTH = GroundTruth(_ZERO, _ZERO)
_NO_DEFLECTION = np.zeros(3), np.zeros(6)


#: Numbers of columns that only some rows have: of a setpoint request, of the measured, observed and desired direction,
#: and of a target.
REQUEST_WIDTH, DIRECTIONS_WIDTH, TARGET_WIDTH = 8, 9, 14


@compiled
def _put(row: Array, at: int, values: Array) -> int:
    """Write values to the columns from index `at` on; return the index after the last one."""
    for k in range(values.shape[0]):
        row[at + k] = values[k]
    return at + values.shape[0]


@compiled
def _fill(
    row: Array, time: float, state: int, phase: int, new: bool, frame_time: float,
    stages: int, tracker: int, sensors: int, truth_known: bool, true_tip: Array, true_force: Array,
    positions: Array, command: Array, sent: Array, wrenches: Array, force: Array, moment: Array,
    tip: Array, loaded: Array, unloaded: Array, origin: Array, setpoint: Array,
    u_int: Array, sigma: Array, at_bound: Array, estimate: Array,
    true_direction: Array, deflection_force: Array, deflection_covariance: Array, clearance: float,
    contact_start: float,
) -> None:  # fmt: skip
    """Fill the channels that every row has, in the order of `_channels`; the other channels keep their values.

    The function is compiled, because numpy calls would take longer than the model. `_put` is not inlined:
    inlined, it made this function take a tenth of the time of all compilations.
    """
    shape, free, known = fields(loaded), fields(unloaded), estimate_fields(estimate)
    row[0], row[1], row[2], row[3], row[4], row[5] = time, state, phase, 0.0, new, frame_time
    row[6], row[7], row[8], row[9] = loaded[PASSES], unloaded[PASSES], estimate[FRAME_USED], loaded[STABILITY]
    row[10], row[11], row[12], row[13] = stages, tracker, sensors, truth_known
    at = _put(row, 14, true_tip)
    at = _put(row, at, true_force)
    at = _put(row, at, positions)
    at = _put(row, at, command)
    at = _put(row, at, sent)
    for i in range(wrenches.shape[0]):
        at = _put(row, at, wrenches[i])
    at = _put(row, at, force)
    at = _put(row, at, moment)
    at = _put(row, at, tip)
    at = _put(row, at, shape.tip)
    at = _put(row, at, free.tip)
    at = _put(row, at, origin + setpoint)
    at = _put(row, at, u_int)
    at = _put(row, at, known.velocity_observed - u_int)
    at = _put(row, at, sigma)
    at = _put(row, at, at_bound)
    at = _put(row, at, known.tips[int(estimate[NEWEST_INDEX])] + known.bias)
    for i in range(known.vectors.shape[0]):
        at = _put(row, at, known.vectors[i])
    at = _put(row, at + REQUEST_WIDTH + DIRECTIONS_WIDTH, true_direction)
    at = _put(row, at + TARGET_WIDTH, deflection_force)
    at = _put(row, at, deflection_covariance)
    row[at], row[at + 1] = clearance, contact_start


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
        Channel("estimates_frozen", ""),
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
        *[channel for name, unit in VECTOR_UNITS.items() for channel in vector(name, unit)],
        Channel("bias_covariance.bias", "m^2"),
        Channel("bias_covariance.both", "m^2/s"),
        Channel("bias_covariance.drift", "m^2/s^2"),
        *vector("force_estimated", "N"),
        *vector("force_variance", "N^2"),
        *[Channel(f"force_covariance.{pair}", "N^2") for pair in ("xy", "xz", "yz")],
        *vector("moment_mismatch", "N m"),
        Channel("load_estimate.bandwidth", "Hz"),
        Channel("load_estimate.misfit", ""),
        Channel("load_estimate.since_tare", "s"),
        Channel("request_kind", ""),
        Channel("request_time", "s"),
        *vector("request", "m"),
        *vector("request_velocity", "m/s"),
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
        *vector("force_by_deflection", "N"),
        *[Channel(f"force_by_deflection_covariance.{pair}", "N^2") for pair in ("xx", "xy", "xz", "yy", "yz", "zz")],
        Channel("clearance", "m"),
        Channel("contact_start", "s"),
        *vector("stiffness", "N/m"),
    ]


TRACKER_CHANNELS = frozenset({
    "tip_measured", "tip_time", "direction_measured", "target_measured", "force_by_deflection",
    "force_by_deflection_covariance",
})  # fmt: skip
SENSOR_CHANNELS = frozenset({
    "force", "force_filtered", "force_estimated", "force_variance", "force_covariance", "moment", "moment_mismatch",
    "deflection", "deflection_filtered", "deflection_rate",
})  # fmt: skip
#: Channels that a tracker alone provides as well, from the deflection of the tip.
FORCE_CHANNELS = frozenset({"force", "force_filtered", "force_variance"})
TRUTH_CHANNELS = frozenset({"tip_true", "force_true", "direction_true", "target_true"})
#: Channels that each tick of the controller updates.
COMPUTED_CHANNELS = TRACKER_CHANNELS | SENSOR_CHANNELS | TRUTH_CHANNELS | {
    "tip_estimated", "tip_desired", "direction_observed", "direction_desired", "u_int", "target_offset",
    "clearance", "contact_start", "stiffness",
}  # fmt: skip
#: Channels of unit vectors; they are 0 if the tip's direction is neither measured nor controlled.
DIRECTION_CHANNELS = ("direction_measured", "direction_observed", "direction_desired", "direction_true")


def stale_groups(channels: Channels, row: Array) -> frozenset[str]:
    """Return the groups of channels whose values in a row are stale or were never known."""
    if channels.of(row, "estimates_frozen")[0]:
        return COMPUTED_CHANNELS
    _, tracker, sensors = channels.of(row, "trouble")
    unknown = (
        (TRACKER_CHANNELS, tracker >= Severity.HOLD or tracker == ABSENT),
        (SENSOR_CHANNELS, sensors >= Severity.HOLD),
        (SENSOR_CHANNELS - FORCE_CHANNELS, sensors == ABSENT),
        (FORCE_CHANNELS, sensors == ABSENT and (tracker >= Severity.HOLD or tracker == ABSENT)),
        (TRUTH_CHANNELS, not channels.of(row, "truth_known")[0]),
    )
    nowhere = (group for group in DIRECTION_CHANNELS if not channels.of(row, group).any())
    return frozenset(nowhere).union(*(groups for groups, old in unknown if old))
