"""Channels of telemetry: one row of numbers for each tick, the same for recordings and live views.

`FIELDS` describes each number once; rows, recordings, live streams and documents are made from it. A new number is one
line there.

A row always has every channel. It repeats the last known values while stages are being homed, lost or reconnected, and
while a device has no valid sample; such values are stale.
"""

from functools import lru_cache
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from core.control.estimation import ESTIMATES, FRAME_USED, Estimate
from core.control.fields import (
    Field,
    Writer,
    base_wrenches,
    direction,
    joint_flags,
    joints,
    named,
    one,
    singular_values,
    vector,
)
from core.control.setpoint_request import SetpointRequest
from core.control.step import ControllerState, Tick
from core.model.solution import PASSES
from core.robot.robot import Array, Robot
from station.config.robots import WHOLE_LOAD
from station.control.follow import TargetValues
from station.control.states import State
from station.devices.interfaces import ABSENT, GroundTruth, JointReading, Severity, TipReading, WrenchReading


class TickRecord(NamedTuple):
    """Values that one tick has read, estimated and commanded; a row of telemetry is made from them."""

    time: float  #: [s]
    state: State
    phase: int  #: a `task.Phase`
    joints: JointReading
    wrenches: WrenchReading
    frame: TipReading | None  #: new tracker frame; None: the values of the last frame are repeated
    tick: Tick
    memory: ControllerState  #: state of the controller after `tick`
    estimate: Estimate  #: estimate in `memory`
    truth: GroundTruth | None  #: None: there is no virtual lab
    trouble: tuple[int, int, int]  #: severities of stages, tracker and force sensors; `ABSENT`: no device
    wanted: SetpointRequest | None  #: latest setpoint request for a streamed tip
    target: TargetValues | None
    contact_start: float  #: time at which a tip that holds a force has touched the obstacle [s]
    force_possible: float  #: size of the force with what tares removed, plus its largest plausible error [N]


def _tip_observed(at: TickRecord) -> Array:
    return at.estimate.model_tip + at.estimate.bias


def _request(at: TickRecord) -> Array | None:
    wanted = at.wanted
    return None if wanted is None or wanted.position is None else at.memory.origin + wanted.position


def _direction_measured(at: TickRecord) -> Array | None:
    known = at.memory.direction
    return known.measured if known is not None and known.measured_once else None


def _direction_desired(at: TickRecord) -> Array | None:
    known, desired = at.memory.direction, at.tick.setpoint.direction
    return None if known is None else known.origin if desired is None else desired


#: Fields in addition to `ESTIMATES`. A field is 0 if its function returns None, for example `x and x.y` if x is None.
_RECORDED = (
    Field("time", "s", "time of the tick", "loop", one, streamed=True),
    Field("state", "", "state of the station", "loop", one, streamed=True),
    Field("phase", "", "phase of the run", "loop", one, streamed=True),
    Field("estimates_frozen", "", "1: the estimates are those of an earlier tick", "loop", one, None, streamed=True),
    Field("tip_new", "", "1: a new tracker frame", "loop", one, lambda at: at.frame is not None),
    Field(
        "tip_time", "s", "time at which the new frame was measured", "tracker", one,
        lambda at: at.frame and at.frame.time,
    ),
    Field(
        "observer_used", "", "1: the tip observer used the frame", "loop", one,
        lambda at: at.estimate.numbers[FRAME_USED],
    ),
    Field("stability", "", "stability margin of the loaded shape", "controller", one, "estimate.loaded.stability"),
    Field(
        "truth_known", "", "1: a virtual lab knows the true values", "loop", one,
        lambda at: at.truth is not None, streamed=True,
    ),
    Field(
        "request_kind", "", "1: the streamed setpoint is a position; 2: a velocity", "loop", one,
        lambda at: at.wanted and (2.0 if at.wanted.position is None else 1.0),
    ),
    Field(
        "request_time", "s", "arrival of the streamed setpoint", "loop", one,
        lambda at: at.wanted and at.wanted.time,
    ),
    Field("target_new", "", "1: a new frame of the target", "loop", one, lambda at: at.target and at.target.new),
    Field(
        "target_followed", "", "1: the tip follows the target", "loop", one,
        lambda at: at.target and at.target.followed, streamed=True,
    ),
    Field(
        "clearance", "m", "smallest distance of the tubes from a region, at most 0.1 m", "controller", one,
        "tick.clearance",
    ),
    Field("contact_start", "s", "time at which the present contact started", "controller", one, streamed=True),
    Field(
        "passes", "", "Newton iterations of the model", "loop", named("loaded", "unloaded"),
        lambda at: (at.estimate.loaded.numbers[PASSES], at.estimate.unloaded.numbers[PASSES]),
    ),
    Field(
        "trouble", "", "severity of each device's fault", "loop", named("stages", "tracker", "sensors"),
        streamed=True,
    ),
    Field("tip_true", "m", "true tip", "lab", vector, lambda at: at.truth and at.truth.tip, streamed=True),
    Field("force_true", "N", "true force at the tip", "lab", vector, lambda at: at.truth and at.truth.force),
    Field("joints", "", "measured joint positions", "stages", joints, "joints.positions", streamed=True),
    Field("velocity_commanded", "/s", "joint velocities of this tick", "loop", joints, "tick.command"),
    Field("velocity_sent", "/s", "joint velocities sent to the stages last", "stages", joints, "joints.sent"),
    Field(
        "wrench_raw", "", "readings of the base sensors, not tared", "sensors", base_wrenches,
        lambda at: at.wrenches.wrenches.ravel(),
    ),
    Field(
        "force", "N", "force at the tip from the sum of the base sensors", "force or deflection", vector,
        "tick.load.force", streamed=True,
    ),
    Field(
        "force_possible", "N", "size of the force with what tares removed, plus its largest plausible error",
        "force or deflection", one, streamed=True,
    ),
    Field("moment", "N m", "moment of the load about the plate's origin", "force", vector, "tick.load.moment"),
    Field("tip_measured", "m", "tip in the last tracker frame", "tracker", vector, "memory.tip", streamed=True),
    Field("tip_estimated", "m", "tip of the loaded model", "controller", vector, "estimate.loaded.tip", streamed=True),
    Field("tip_unloaded", "m", "tip of the model without load", "controller", vector, "estimate.unloaded.tip"),
    Field(
        "tip_desired", "m", "setpoint of the tip", "controller", vector,
        lambda at: at.memory.origin + at.tick.setpoint.position, streamed=True,
    ),
    Field(
        "u_int", "m/s", "tip velocity that the outer loop requests", "controller", vector,
        "tick.u_int", streamed=True,
    ),
    Field("delta", "m/s", "observed minus requested tip velocity, eq. (27)", "controller", vector, "tick.delta"),
    Field(
        "sigma", "m/s", "singular values of the Jacobian, joints in units of top speed", "controller", singular_values,
        "tick.sigma",
    ),
    Field(
        "at_bound", "", "-1, 1: the joint velocity is at its lower or upper bound", "controller", joint_flags,
        "tick.at_bound",
    ),
    Field("tip_observed", "m", "tip estimated by the observer", "controller", vector, _tip_observed),
    Field("request", "m", "position of the streamed setpoint", "loop", vector, _request),
    Field(
        "request_velocity", "m/s", "velocity of the streamed setpoint", "loop", vector,
        lambda at: at.wanted and at.wanted.velocity,
    ),
    Field(
        "direction_measured", "", "measured direction of the tip", "tracker", direction,
        _direction_measured, streamed=True,
    ),
    Field(
        "direction_observed", "", "direction estimated by the observer", "controller", direction,
        lambda at: at.memory.direction and at.memory.direction.observed, streamed=True,
    ),
    Field(
        "direction_desired", "", "setpoint of the direction", "controller", direction,
        _direction_desired, streamed=True,
    ),
    Field(
        "direction_true", "", "true direction of the tip", "lab", direction,
        lambda at: at.truth and at.truth.direction, streamed=True,
    ),
    Field(
        "target_measured", "m", "position of the target in its last tracker frame", "tracker", vector,
        lambda at: at.target and at.target.measured, streamed=True,
    ),
    Field("target_predicted", "m", "predicted target", "tracker", vector, lambda at: at.target and at.target.predicted),
    Field(
        "target_offset", "m", "tip minus target", "controller", vector,
        lambda at: at.target and at.target.offset, streamed=True,
    ),
    Field("target_true", "m", "true target", "lab", vector, lambda at: at.target and at.target.true, streamed=True),
    Field(
        "force_by_deflection", "N", "force from the tip's deflection", "tracker", vector,
        lambda at: at.memory.deflection and at.memory.deflection.force,
    ),
    Field(
        "force_by_deflection_covariance", "N^2", "covariance of force_by_deflection", "tracker",
        named("xx", "xy", "xz", "yy", "yz", "zz"), lambda at: at.memory.deflection and at.memory.deflection.covariance,
    ),
    Field(
        "stiffness", "N/m", "stiffness of the tip along the axes of its frame", "controller", vector,
        lambda at: at.tick.setpoint.stiffness and at.tick.setpoint.stiffness.axes, streamed=True,
    ),
)  # fmt: skip
FIELDS = (*_RECORDED, *ESTIMATES)


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
        found = list[Channel]()
        self._at = dict[str, slice]()
        for field in FIELDS:
            parts = field.parts(robot, field.unit)
            self._at[field.name] = slice(len(found), len(found) + len(parts))
            found += [Channel(f"{field.name}.{part}" if part else field.name, unit) for part, unit in parts]
        self.all = tuple(found)
        self.partial = robot.sensed not in WHOLE_LOAD  #: whether the force sensors measure a part of the load only
        paths = {field.read or field.name: self._place(field) for field in _RECORDED if isinstance(field.read, str)}
        self._attributes, self._places = attrgetter(*paths), tuple(paths.values())
        self._functions = [(self._place(field), field.read) for field in _RECORDED if callable(field.read)]
        self._estimates = slice(self._at[ESTIMATES[0].name].start, len(found))

    def _place(self, field: Field) -> int | slice:
        """Return the column of a number or the slice of a group; writing one number takes half the time of a slice."""
        return self._at[field.name].start if field.parts is one else self._at[field.name]

    def __len__(self) -> int:
        return len(self.all)

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the fields, which `of` accepts."""
        return tuple(self._at)

    def of(self, rows: Array, group: str) -> Array:
        """Return the columns of a field, for example (..., 3) for `tip_measured`."""
        return rows[..., self._at[group]]

    def row(self, at: TickRecord) -> Array:
        """Return the row of one tick: its numbers in the order of the channels in `all`.

        Without sensors for the whole load, force and variance are those of the force from the deflection.
        """
        row, deflection = np.zeros(len(self.all)), at.memory.deflection
        for where, value in zip(self._places, self._attributes(at), strict=True):
            row[where] = value
        for where, read in self._functions:
            if (value := read(at)) is not None:
                row[where] = value
        row[self._estimates] = at.estimate.vectors
        if (self.partial or at.trouble[2] == ABSENT) and deflection is not None:
            self.of(row, "force_filtered")[:] = deflection.force
            self.of(row, "force_variance")[:] = deflection.covariance[[0, 3, 5]]
        return row

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


#: Writers whose fields a tick without usable samples does not change.
_FROZEN: tuple[Writer, ...] = ("tracker", "force", "force or deflection", "controller", "lab")


def stale_groups(channels: Channels, row: Array) -> frozenset[str]:
    """Return the fields whose values in a row are stale or were never known."""
    frozen = bool(channels.of(row, "estimates_frozen")[0])
    _, tracker, sensors = channels.of(row, "trouble").tolist()
    stale = _stale(frozen, tracker, sensors, channels.partial, bool(channels.of(row, "truth_known")[0]))
    return stale.union(group for group in DIRECTIONS if not channels.of(row, group).any())


@lru_cache(maxsize=64)
def _stale(frozen: bool, tracker: int, sensors: int, partial: bool, truth_known: bool) -> frozenset[str]:
    def silent(trouble: int) -> bool:
        return trouble >= Severity.HOLD or trouble == ABSENT

    without: dict[Writer, bool] = {
        "sensors": silent(sensors), "tracker": silent(tracker), "lab": not truth_known,
        "force": partial or silent(sensors),
        "force or deflection": silent(tracker) if partial or sensors == ABSENT else silent(sensors),
    }  # fmt: skip
    return frozenset(field.name for field in FIELDS if (frozen and field.by in _FROZEN) or without.get(field.by, False))


#: Names of the unit vectors; they are 0 while the tip's direction is neither measured nor controlled.
DIRECTIONS = tuple(field.name for field in FIELDS if field.parts is direction)
