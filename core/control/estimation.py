"""First half of a tick: turn a sample of the devices into estimates of deflection, load, joints and tip.

`perceive` sums the base wrenches, solves the model with and without load, and computes the estimates in one compiled
call. q are the joint positions, w is the load, J the Jacobian and C the compliance.

| estimate | how it is computed |
|---|---|
| deflection Delta_total, its numerical and its filtered rate | F(q, w) - F(q, 0), eq. (25) |
| tip velocity by the load, exact rate of Delta_total | C w', C w' + (J(q, w) - J(q, 0)) q'; w' of the filtered force |
| the deflection's parts Delta_1 and Delta_2 | eq. (22), integrated with the trapezoidal rule |
| the joints' velocity, and their travel until a command sent now takes effect | `Actuation` |
| the tip, its velocity, and its predicted position | the model under the smoothed load, corrected by the `observer` |

The stages' command path is a sample-and-hold with a transport delay. The serial line to the stages carries one command
per axis and command interval. A command waits half an interval on average, arrives after the transport delay, and is
then applied for one interval. Before a command takes effect, the velocities sent earlier (after limits and
quantisation) move the joints. The controller therefore plans for the joint positions at which its command takes effect.
"""

import math
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np

from core.compiled import Shapes, compiled, copy, packed_size, part
from core.control.fields import Field, named, vector
from core.control.observer import Observer, ObserverState, RateFilter, filtered, gains, observe
from core.control.sensors import FusedLoad, fused_at
from core.control.tip_force import BANDWIDTH, FORCE, QUALITY, LoadEstimator, estimate_force
from core.control.tip_residual import (
    FACTOR,
    HARMFUL,
    SHARE,
    TOLERANCE,
    TipResidual,
    advance_directions,
    apply_residual,
    next_gain,
    table_of,
)
from core.errors import DescriptionError
from core.model.newton import CONTROL_STEP_RAD, newton
from core.model.solution import Solution, fields, pure_force
from core.model.statics import Statics
from core.robot.robot import Array, unpack


class ActuationState(NamedTuple):
    """State of the command path: the velocities already sent to the stages, and the joint motion that they cause."""

    sent: Array  #: (ticks, n) joint velocities sent to the stages, newest first [rad/s or m/s]
    ahead: Array  #: (n,) distance that the joints still move until a command sent now takes effect [rad or m]

    @property
    def velocity(self) -> Array:
        """(n,) present joint velocity [rad/s or m/s]."""
        return self.sent[-1]


@dataclass(frozen=True)
class Actuation:
    """Command interval and delay of the line to the stages."""

    period: float  #: time between two ticks of the controller [s]
    command_interval: float = 0.025  #: time between two commands to the same axis [s]
    transport_delay: float = 0.012  #: time from sending a command until the motor receives it [s]

    def __post_init__(self) -> None:
        for name in ("command_interval", "transport_delay"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 <= value <= 1.0):
                raise DescriptionError(f"actuation: {name} {value:g} s is outside 0 ... 1 s")

    @property
    def lead_time(self) -> float:
        """Average time from a command to its effect on the joint [s]."""
        return self.transport_delay + 0.5 * self.command_interval

    def start(self, joints: int) -> ActuationState:
        """Return the state of the command path for joints at rest."""
        ticks = round(self.transport_delay / self.period) + 1
        return ActuationState(np.zeros((ticks, joints)), np.zeros(joints))

    def update(self, last: ActuationState, sent: Array) -> ActuationState:
        """Return the state one tick later; `sent` (n,) are the joint velocities sent last [rad/s or m/s]."""
        new = ActuationState(np.empty_like(last.sent), np.empty_like(last.ahead))
        advance(last.sent, sent, self.period, 0.5 * self.command_interval, *new)
        return new


@compiled
def advance(history: Array, sent: Array, period: float, wait: float, moved: Array, ahead: Array) -> None:
    """Compute `Actuation.update` and write the new state to `moved` and `ahead`."""
    ticks, n = history.shape
    for j in range(n):
        moved[0, j] = sent[j]
        ahead[j] = wait * sent[j]
        for i in range(1, ticks):
            moved[i, j] = history[i - 1, j]
            ahead[j] += period * moved[i - 1, j]


#: Indices of the scalars at the start of an estimate's array: number of joints; number of ticks with stored velocities;
#: number of stored tips; index of the newest tip; whether the observer used a tracker frame in this tick; number of
#: frames in a row that the observer rejected; number of ticks since it used a frame.
JOINT_COUNT, DELAY_TICKS, HISTORY_TICKS, NEWEST_INDEX, FRAME_USED, REJECTED_COUNT, UNUSED_TICKS = range(7)
#: Number of these scalars.
SCALAR_COUNT = UNUSED_TICKS + 1
#: Time constant with which the smoothed force approaches the filtered force [s].
SMOOTHING_TIME_S = 30.0


class EstimateFields(NamedTuple):
    """Named views of an estimate's array; `ESTIMATES` states unit and meaning of each vector (3,), world frame."""

    deflection: Array
    deflection_rate_raw: Array
    deflection_filtered: Array
    deflection_rate: Array
    force_filtered: Array
    force_rate: Array
    force_smooth: Array
    load_rate: Array
    deflection_rate_exact: Array
    delta_1: Array
    delta_2: Array
    velocity_observed: Array
    tip_ahead: Array
    bias: Array
    drift: Array
    refused: Array
    bias_covariance: Array
    load: Array  #: (5, 3) five vectors, see `tip_force`
    residual: Array
    residual_state: Array
    vectors: Array  #: (24, 3) all vectors in one matrix, one per row
    directions: Array  #: (n,) state of each joint's last motion, see `tip_residual`
    ahead: Array  #: (n,) distance that the joints still move until a command sent now takes effect [rad or m]
    sent: Array  #: (ticks, n) joint velocities sent to the stages, newest first [rad/s or m/s]
    tips: Array  #: (history, 3) the model's tips of the last ticks [m]


#: The vectors of `EstimateFields`, in their order.
ESTIMATES = (
    Field("deflection", "m", "model's loaded tip minus its unloaded tip, eq. (25)", "force", vector, streamed=True),
    Field("deflection_rate_raw", "m/s", "change of the deflection in one tick, unfiltered", "force", vector),
    Field("deflection_filtered", "m", "filtered deflection", "force", vector, streamed=True),
    Field("deflection_rate", "m/s", "rate of the filtered deflection", "force", vector, streamed=True),
    Field("force_filtered", "N", "filtered force at the tip", "force or deflection", vector, streamed=True),
    Field("force_rate", "N/s", "rate of the filtered force", "force", vector),
    Field("force_smooth", "N", "smoothed force with the rate `force_rate`", "force", vector),
    Field("load_rate", "m/s", "tip velocity C w' that the changing load causes", "force", vector),
    Field("deflection_rate_exact", "m/s", "rate of the deflection, C w' + (J(q, w) - J(q, 0)) q'", "force", vector),
    Field("delta_1", "m", "part of the deflection that the load causes, eq. (22)", "force", vector),
    Field("delta_2", "m", "part of the deflection that the joints cause, eq. (22)", "force", vector),
    Field("velocity_observed", "m/s", "tip velocity J q' + C w' + drift", "controller", vector),
    Field("tip_ahead", "m", "predicted tip when a command sent now takes effect", "controller", vector),
    Field("bias", "m", "measured tip minus the model's tip", "tracker", vector),
    Field("drift", "m/s", "rate of the bias", "tracker", vector),
    Field("refused", "m", "measured minus the model's tip in the latest rejected tracker frame", "tracker", vector),
    Field(
        "bias_covariance", "", "variance of bias, covariance of bias and drift, variance of drift", "tracker",
        named("bias", "both", "drift", units=("m^2", "m^2/s", "m^2/s^2")),
    ),
    Field("force_estimated", "N", "estimated force at the tip, unfiltered", "force", vector),
    Field("force_variance", "N^2", "variance of the force", "force or deflection", vector, streamed=True),
    Field("force_covariance", "N^2", "covariances of the estimated force", "force", named("xy", "xz", "yz")),
    Field("moment_mismatch", "N m", "measured moment minus that of the estimated force", "force", vector),
    Field(
        "load_estimate", "", "force filter bandwidth, chi square of the moment mismatch, time since the tare", "force",
        named("bandwidth", "misfit", "since_tare", units=("Hz", "", "s")),
    ),
    Field("residual", "m", "learned residual in the model's tip", "controller", vector),
    Field(
        "residual_state", "", "explained share of the variance, factor (0: off), time for which it increased the error",
        "controller", named("share", "factor", "harmful", units=("", "", "s")),
    ),
)  # fmt: skip
#: Number of vectors in the array of an estimate.
VECTOR_COUNT = len(ESTIMATES)


@compiled
def _shapes(n: int, ticks: int, history: int) -> Shapes:
    """Return the shapes of an estimate's array: scalars, `vectors`, `directions`, `ahead`, `sent`, `tips`."""
    return (1, SCALAR_COUNT), (VECTOR_COUNT, 3), (1, n), (1, n), (ticks, n), (history, 3)


#: Index of the estimated force at the tip in an estimate's array.
FORCE_START = SCALAR_COUNT + 3 * EstimateFields._fields.index("load")


@compiled
def estimate_fields(numbers: Array) -> EstimateFields:
    """Return named views of an estimate's array."""
    shapes = _shapes(int(numbers[JOINT_COUNT]), int(numbers[DELAY_TICKS]), int(numbers[HISTORY_TICKS]))
    v = part(numbers, shapes, 1)
    return EstimateFields(
        v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10], v[11], v[12], v[13], v[14], v[15], v[16],
        v[17:22], v[22], v[23], v, part(numbers, shapes, 2)[0], part(numbers, shapes, 3)[0], part(numbers, shapes, 4),
        part(numbers, shapes, 5),
    )  # fmt: skip


def _views(numbers: Array) -> EstimateFields:
    """Return the views of `estimate_fields`, whose compiled code takes twice as long when Python calls it."""
    parts = _layout(int(numbers[JOINT_COUNT]), int(numbers[DELAY_TICKS]), int(numbers[HISTORY_TICKS]))
    v, directions, ahead, sent, tips = (numbers[where].reshape(shape) for where, shape in parts)
    return EstimateFields._make((*v[:17], v[17:22], v[22], v[23], v, directions[0], ahead[0], sent, tips))


@cache
def _layout(n: int, ticks: int, history: int) -> list[tuple[slice, tuple[int, int]]]:
    """Return slice and shape of `vectors`, `directions`, `ahead`, `sent` and `tips` in an estimate's array."""
    shapes = _shapes(n, ticks, history)
    ends = np.cumsum([rows * columns for rows, columns in shapes]).tolist()
    return [(slice(start, end), shape) for start, end, shape in zip(ends, ends[1:], shapes[1:], strict=False)]


class _Vector:
    """Attribute that reads one vector (3,) of an estimate, faster than `known`, which creates views of all vectors."""

    def __set_name__(self, owner: type, name: str) -> None:
        start = SCALAR_COUNT + 3 * EstimateFields._fields.index(name)
        self._where = slice(start, start + 3)

    def __get__(self, estimate: "Estimate", owner: type | None = None) -> Array:
        return estimate.numbers[self._where]


class Estimate:
    """Estimates of one tick, and the state of the filters that the next tick needs."""

    __slots__ = ("_known", "loaded", "numbers", "unloaded")

    load_rate, velocity_observed, tip_ahead, bias, drift = _Vector(), _Vector(), _Vector(), _Vector(), _Vector()

    def __init__(self, loaded: Solution, unloaded: Solution, numbers: Array) -> None:
        self.loaded = loaded  #: solved model under the estimated load
        self.unloaded = unloaded  #: solved model without load
        self.numbers = numbers  #: all estimates in one array; `known` names its parts
        self._known: EstimateFields | None = None

    @property
    def known(self) -> EstimateFields:
        """Named views of the array `numbers`."""
        if self._known is None:
            self._known = _views(self.numbers)
        return self._known

    @property
    def force(self) -> Array:
        """(3,) estimated force at the tip, `known.load[FORCE]` [N]."""
        return self.numbers[FORCE_START : FORCE_START + 3]

    @property
    def vectors(self) -> Array:
        """Numbers of `ESTIMATES`, in their order."""
        return self.numbers[SCALAR_COUNT : SCALAR_COUNT + 3 * VECTOR_COUNT]

    @property
    def model_tip(self) -> Array:
        """(3,) newest of the model's stored tips [m]."""
        end = self.numbers.size - 3 * (self.numbers.item(HISTORY_TICKS) - self.numbers.item(NEWEST_INDEX))
        return self.numbers[int(end) : int(end) + 3]

    @property
    def observed(self) -> ObserverState:
        """State of the tip observer."""
        known, newest = self.known, int(self.numbers[NEWEST_INDEX])
        return ObserverState(
            known.bias, known.drift, known.bias_covariance, known.tips, newest, self.numbers[FRAME_USED] > 0.0,
            known.refused, int(self.numbers[REJECTED_COUNT]), int(self.numbers[UNUSED_TICKS]),
        )  # fmt: skip

    def for_actuation(self, actuation: Actuation) -> "Estimate":
        """Return the same estimate with the stored velocities that the delay of `actuation` needs."""
        known, (ticks, n) = self.known, actuation.start(self.loaded.joints.size).sent.shape
        history = len(known.tips)
        if ticks == len(known.sent):
            return self
        numbers = np.zeros(packed_size(_shapes(n, ticks, history)))
        end = self.numbers.size - known.sent.size - known.tips.size  # both are the last parts of the array
        numbers[:end], numbers[DELAY_TICKS] = self.numbers[:end], ticks
        estimate = Estimate(self.loaded, self.unloaded, numbers)
        kept = min(ticks, len(known.sent))
        estimate.known.sent[:kept], estimate.known.tips[:] = known.sent[:kept], known.tips
        return estimate


@dataclass(frozen=True)
class Estimator:
    """The filters of a controller: deflection, force, tip observer and command path."""

    filter: RateFilter  #: filter of deflection and force
    observer: Observer
    actuation: Actuation
    load: LoadEstimator = field(default_factory=LoadEstimator)  #: estimator of the force at the tip
    residual: TipResidual | None = None  #: learned residual of the model; None: the model is not corrected

    def start(self, loaded: Solution, unloaded: Solution, force: Array, tip: Array) -> Estimate:
        """Return the estimate at rest under `force` (3,) [N] with the measured tip `tip` (3,) [m]."""
        observed, motion = self.observer.start(loaded.tip, tip), self.actuation.start(loaded.joints.size)
        ticks, n = motion.sent.shape
        history = len(observed.tips)
        numbers = np.zeros(packed_size(_shapes(n, ticks, history)))
        numbers[JOINT_COUNT], numbers[DELAY_TICKS], numbers[HISTORY_TICKS], numbers[FRAME_USED] = (
            n,
            ticks,
            history,
            observed.used,
        )
        now = Estimate(loaded, unloaded, numbers)
        known = now.known
        known.deflection[:] = known.deflection_filtered[:] = self.filter.start(loaded.tip - unloaded.tip).value
        known.force_filtered[:] = known.force_smooth[:] = self.filter.start(force).value
        known.load[:] = self.load.start(force, self.filter.bandwidth)
        known.tip_ahead[:] = tip
        known.bias[:], known.drift[:], known.bias_covariance[:], known.tips[:] = observed[:4]
        return now

    @cached_property
    def residual_packed(self) -> Array | None:
        """Packed residual; None if there is no residual, so that the compiler leaves out its code."""
        return None if self.residual is None else self.residual.packed()

    @cached_property
    def settings(self) -> Array:
        """Packed filter settings, the first argument of `estimate`."""
        observer, actuation = self.observer, self.actuation
        return np.array([
            self.filter.period, *((-1.0, 0.0) if self.load.adapts else self.filter.gain),
            0.5 * actuation.command_interval, actuation.lead_time,
            observer.noise**2, observer.wander, observer.gate,
        ])  # fmt: skip


@compiled
def estimate(
    settings: Array, loaded: Array, unloaded: Array, old_loaded: Array, old_unloaded: Array,
    last: Array, force: Array, sent_now: Array, frame: Array, age: float, numbers: Array,
) -> None:  # fmt: skip
    """Compute the estimate of one tick into `numbers`.

    Args:
        settings: packed settings `Estimator.settings`.
        loaded, unloaded: arrays of this tick's solutions with and without load.
        old_loaded, old_unloaded, last: solutions and estimate of the previous tick.
        force: (3,) estimated force at the tip, for which `loaded` was solved [N].
        sent_now: (n,) joint velocities sent to the stages last [rad/s or m/s].
        frame, age: a new tracker frame (3,) [m] and the time since it was measured [s]; age below 0: no frame.
        numbers: array of the new estimate; on entry a copy of `last` that already contains this tick's `load`.

    """
    period, k_value, k_rate, wait, lead_time, noise, wander, gate = settings
    if k_value < 0.0:
        k_value, k_rate = gains(period, estimate_fields(numbers).load[QUALITY, BANDWIDTH])
    with_load, free, had_load, was_free = fields(loaded), fields(unloaded), fields(old_loaded), fields(old_unloaded)
    old, new = estimate_fields(last), estimate_fields(numbers)
    advance(old.sent, sent_now, period, wait, new.sent, new.ahead)
    velocity, model_tip = new.sent[-1], np.empty(3)
    for i in range(3):
        new.deflection[i] = with_load.tip[i] - free.tip[i]
        new.deflection_rate_raw[i] = (new.deflection[i] - old.deflection[i]) / period
    filtered(
        old.deflection_filtered, old.deflection_rate, new.deflection,
        new.deflection_filtered, new.deflection_rate, period, k_value, k_rate,
    )  # fmt: skip
    filtered(
        old.force_filtered, old.force_rate, force, new.force_filtered, new.force_rate, period, k_value, k_rate
    )  # fmt: skip
    # The smoothed force is the integral of `force_rate`. Because the filter's gains change, the integral would drift
    # away from the filter's state. It is therefore also pulled toward the value that it has at constant gains.
    lag, leak = k_value / k_rate - period, period / SMOOTHING_TIME_S
    for i in range(3):
        steady = new.force_filtered[i] - lag * new.force_rate[i]
        new.force_smooth[i] = old.force_smooth[i] + period * new.force_rate[i]
        new.force_smooth[i] += leak * (steady - new.force_smooth[i])
    for i in range(3):
        along, extra_travel, by_force, by_joints, travel, extra_rate = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        model_tip[i] = with_load.tip[i]
        for j in range(6):
            compliance = 0.5 * (had_load.compliance[i, j] + with_load.compliance[i, j])
            along += compliance * (with_load.wrench[j] - had_load.wrench[j])
        for j in range(3):
            by_force += with_load.compliance[i, j] * new.force_rate[j]
            # The force noise of a single sample would move the model's tip by a millimetre, so the tip is evaluated
            # under the smoothed force. The smoothed force has the rate `force_rate`, from which `load_rate` follows, so
            # the lag of both has the same effect on the bias and its drift.
            model_tip[i] += with_load.compliance[i, j] * (new.force_smooth[j] - force[j])
        for j in range(velocity.shape[0]):
            extra = with_load.jacobian[i, j] - free.jacobian[i, j]
            old_extra = had_load.jacobian[i, j] - was_free.jacobian[i, j]
            extra_travel += 0.5 * (extra + old_extra) * (with_load.joints[j] - had_load.joints[j])
            extra_rate += extra * velocity[j]
            by_joints += with_load.jacobian[i, j] * velocity[j]
            travel += with_load.jacobian[i, j] * new.ahead[j]
        new.load_rate[i] = by_force
        new.deflection_rate_exact[i] = by_force + extra_rate
        new.delta_1[i] = old.delta_1[i] + along
        new.delta_2[i] = old.delta_2[i] + extra_travel
        new.velocity_observed[i] = by_force + by_joints
        new.tip_ahead[i] = model_tip[i] + travel + lead_time * by_force
    numbers[NEWEST_INDEX], numbers[FRAME_USED], numbers[REJECTED_COUNT], numbers[UNUSED_TICKS] = observe(
        new.bias, new.drift, new.bias_covariance, new.tips, new.refused, int(last[NEWEST_INDEX]),
        int(last[REJECTED_COUNT]), int(last[UNUSED_TICKS]),
        model_tip, frame, age, period, noise, wander, gate,
    )  # fmt: skip
    for i in range(3):
        new.velocity_observed[i] += new.drift[i]
        new.tip_ahead[i] += new.bias[i] + lead_time * new.drift[i]


@compiled
def corrected(
    residual: Array, period: float, loaded: Array, unloaded: Array, old_loaded: Array, last: Array, numbers: Array
) -> None:  # fmt: skip
    """Add the packed residual to this tick's solutions, and its state to `numbers`; arguments as in `estimate`."""
    old, new = estimate_fields(last), estimate_fields(numbers)
    advance_directions(
        table_of(residual), fields(old_loaded).joints, fields(loaded).joints, old.directions, new.directions
    )
    gain, worse = old.residual_state[FACTOR], old.residual_state[HARMFUL]
    gain, worse = next_gain(residual[TOLERANCE], period, old.bias, old.residual, gain, worse)
    share = apply_residual(residual, gain, new.directions, loaded, unloaded, new.residual)
    new.residual_state[SHARE], new.residual_state[FACTOR], new.residual_state[HARMFUL] = share, gain, worse


#: Wrench on the tip of an unloaded pose: zero [N, N m].
NO_LOAD = np.zeros(6)


def perceive(
    statics: Statics, estimator: Estimator, last: Estimate,
    joints: Array, wrenches: Array, zeros: Array, sent: Array, tip: Array | None, age: float,
) -> tuple[FusedLoad, Estimate]:  # fmt: skip
    """Return load and estimate of one tick from the devices' readings.

    Args:
        statics: model of the robot.
        estimator: filters of the controller.
        last: estimate of the previous tick.
        joints: measured joint positions (n,) [rad or m].
        wrenches: tared wrenches of the base sensors (s, 6), each in the axes of its sensor [N, N m].
        zeros: estimated zeros of the sensors since the tare (s, 6), which are subtracted [N, N m].
        sent: joint velocities (n,) sent to the stages last [rad/s or m/s].
        tip, age: tip (3,) in a new tracker frame [m], and the frame's age since its measurement [s]; tip None: no new
            frame.

    Raises:
        PoseError, NoSolution: the model has no shape at the measured pose and load.
        NotFinite: the measured load is not finite.

    """
    frame, age = (sent, -1.0) if tip is None else (tip, age)
    before = (last.loaded.numbers, last.unloaded.numbers, last.numbers)
    loaded, unloaded, numbers, total = *map(np.empty, map(len, before)), np.empty(6)
    load, now = FusedLoad(total[:3], total[3:]), Estimate(Solution(loaded), Solution(unloaded), numbers)
    if not _perceive(
        *statics.compiled_arguments, estimator.settings, estimator.load.settings, estimator.residual_packed,
        joints, wrenches, zeros, sent, frame, age, *before, 1,
        total, loaded, unloaded, numbers,
    ):  # fmt: skip
        # The warm start did not converge: `Statics.solve` follows the branch in smaller steps, or starts from rest.
        force = now.known.load[FORCE]
        now.loaded = statics.solve(joints, pure_force(force), last.loaded)
        now.unloaded = statics.solve(joints, NO_LOAD, last.unloaded)
        if (residual := estimator.residual_packed) is not None:
            corrected(
                residual, estimator.filter.period, now.loaded.numbers, now.unloaded.numbers,
                last.loaded.numbers, last.numbers, numbers,
            )  # fmt: skip
        estimate(
            estimator.settings, now.loaded.numbers, now.unloaded.numbers, *before,
            force, sent, frame, age, numbers,
        )  # fmt: skip
    return load, now


@compiled
def _perceive(
    packed: Array, order: int, sublink: float, tubes: tuple[float, ...], columns: tuple[float, ...], settings: Array,
    load_settings: Array, residual: Array | None, joints: Array, readings: Array, zeros: Array, sent: Array,
    frame: Array, age: float, near_loaded: Array, near_unloaded: Array, last: Array, careful: int,
    load: Array, loaded: Array, unloaded: Array, now: Array,
) -> bool:  # fmt: skip
    """Compute `perceive` into the last four arguments; return False if the model was not solved.

    After False only the load is valid: the sum `load` and the force estimate in `now`. The argument `careful` is always
    1. As a constant inside this function, `careful` would make the compiler build a second Newton solver.
    """
    layout, wrenches = unpack(packed), np.empty(readings.shape)
    for i in range(readings.shape[0]):
        for k in range(6):
            wrenches[i, k] = readings[i, k] - zeros[i, k]
    copy(fused_at(layout, joints, wrenches), load)
    copy(last, now)
    force = estimate_fields(now).load
    estimate_force(
        load_settings, settings[0], layout, joints, wrenches, fields(near_loaded).tip, estimate_fields(last).load, force
    )
    wrench, nothing, tip, close = np.zeros(6), np.zeros(6), math.inf, CONTROL_STEP_RAD
    copy(force[FORCE], wrench)
    if not (
        newton(packed, order, sublink, joints, wrench, near_loaded, tip, careful, close, tubes, columns, loaded)
        and newton(
            packed, order, sublink, joints, nothing, near_unloaded, tip, careful, close, tubes, columns, unloaded
        )
    ):
        return False
    if residual is not None:
        corrected(residual, settings[0], loaded, unloaded, near_loaded, last, now)
    estimate(settings, loaded, unloaded, near_loaded, near_unloaded, last, force[FORCE], sent, frame, age, now)
    return True
