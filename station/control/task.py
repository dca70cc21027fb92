"""Tasks of the control loop: the phases of a run, and the motions that give an order at each tick.

A run approaches its start pose, rests to tare the sensors and to measure the start tip, and then executes its motion. A
motion is planned, follows a target (`follow`), or is streamed by a client. A jog lasts only while the client renews it.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal, NamedTuple, Protocol

import numpy as np

from core.control.controller_settings import Controller
from core.control.force_control import Press
from core.control.setpoint_request import (
    DEFAULT_MOTION_BOUNDS,
    DEFAULT_TURN_BOUNDS,
    MotionBounds,
    SetpointRequest,
    StreamedTip,
)
from core.control.trajectories import JointMotion, Setpoint, rotated
from core.robot.robot import Array
from station.config.motions import FollowMotion, Orders
from station.control.monitors import Margins
from station.devices.interfaces import WrenchReading

#: Time at rest in which the filters settle [s].
SETTLE_S = 0.5
#: Time after the settling in which readings are averaged for the tare and the start tip [s]; the tracker sends 60
#: frames in this time.
AVERAGE_S = 1.5


#: Time for which a rest is repeated if the robot is not at rest [s].
LONGEST_REST_S = 10.0
#: Number of parts of the readings at rest whose means are compared. The robot was not at rest if they differ by more
#: than this number of standard deviations of a mean, and by more than this force [N], moment [N m] or distance [m].
PARTS, DEVIATIONS = 5, 7.0
LEAST_FORCE_N, LEAST_MOMENT_N_M, LEAST_TIP_M = 0.02, 1e-3, 3e-4
#: Smallest number of samples that are judged, and median of the difference of two normal numbers with deviation 1.
LEAST_SAMPLES, MEDIAN_DIFFERENCE = 20, 0.954


class SettlePhase:
    """Readings of the force sensors and of the tip while the robot rests, and their means."""

    def __init__(self, since: float, begin: float | None = None, *, untouched: bool = False) -> None:
        self.since = since  #: start of the measurement [s]
        self.untouched = untouched  #: whether a person has confirmed that nothing touches the robot meanwhile
        self._begin = since if begin is None else begin  # start of the first of several measurements [s]
        self._wrenches: list[Array] = []
        self._times: list[float] = []  # times of the wrenches' measurement [s]
        self._tips: list[Array] = []

    @property
    def counted(self) -> bool:
        """Whether there are readings."""
        return bool(self._wrenches)

    def take(self, wrenches: WrenchReading, tip: Array | None) -> None:
        """Add the wrenches of one tick and, after a new tracker frame, its tip (3,) [m]."""
        self._wrenches.append(wrenches.wrenches)
        self._times.append(wrenches.time)
        if tip is not None:
            self._tips.append(tip)

    @property
    def wrenches(self) -> Array:
        """Mean wrench of each sensor, one row of 6 [N, N m]."""
        return np.mean(self._wrenches, axis=0)

    def again(self, now: float) -> "SettlePhase | None":
        """Return a new measurement that starts at `now` [s]; None if the robot has not been at rest for too long."""
        if now - self._begin >= LONGEST_REST_S:
            return None
        return SettlePhase(now, self._begin, untouched=self.untouched)

    @property
    def unrest(self) -> str:
        """Why the means are no reference, because the readings changed, in one line; empty after a rest."""
        wrenches = np.array(self._wrenches).reshape(len(self._wrenches), -1, 6)
        times, frames = np.array(self._times), np.arange(float(len(self._tips)))
        for what, readings, at, least, unit, scale in (
            ("the force on a sensor", wrenches[..., :3], times, LEAST_FORCE_N, "N", 1.0),
            ("the moment on a sensor", wrenches[..., 3:], times, LEAST_MOMENT_N_M, "N mm", 1e3),
            ("the tip's position", np.array(self._tips), frames, LEAST_TIP_M, "mm", 1e3),
        ):
            change = _change(readings, at)
            if change > least:
                return (
                    f"the robot was not at rest: {what} changed by {scale * change:.2g} {unit} (at most"
                    f" {scale * least:.2g} {unit}); keep hands and loads off the robot, and repeat this"
                )
        return ""

    @property
    def tip(self) -> Array | None:
        """Mean position of the tip (3,) [m]; None without a tracker frame."""
        return np.mean(self._tips, axis=0) if self._tips else None


def _change(readings: Array, times: Array) -> float:
    """Return the largest difference between the means of parts of readings (k, ...); 0 if it is below noise.

    A sample that several ticks have read, with the same time in `times` (k,), counts once. Otherwise its noise would
    look like a change.
    """
    fresh = np.diff(times, prepend=-np.inf) > 0.0
    if fresh.sum() < LEAST_SAMPLES:
        return 0.0
    noise = np.median(np.abs(np.diff(readings[fresh], axis=0)), axis=0) / MEDIAN_DIFFERENCE
    samples = max(1.0, min(float(part.sum()) for part in np.array_split(fresh, PARTS)))
    changes = np.ptp([part.mean(axis=0) for part in np.array_split(readings, PARTS)], axis=0)
    changes[changes < DEVIATIONS * noise / math.sqrt(samples)] = 0.0
    return float(changes.max(initial=0.0))


#: Speed of the joint with the longest travel time, as a fraction of its top speed. The other joints move slower, so
#: that all joints arrive together.
SPEED_SHARE = 0.5
#: Rate at which the remaining distance to the start pose decays near the end of the approach [1/s].
APPROACH_RATE_HZ = 2.0
#: Largest remaining travel time at top speed at which a joint counts as arrived [s]: about a hundred microsteps.
ARRIVAL_TOLERANCE = 2e-3


#: Speed of the position setpoint [m/s] and of the direction setpoint [rad/s] below which the tip counts as at rest.
REST_SPEED_M_S, REST_TURN_RAD_S = 1e-4, 1e-3


class StreamRequest(NamedTuple):
    """Latest request of the client that commands the tip of a run."""

    run: int  #: number of the run
    setpoint: SetpointRequest | None  #: None: the client has disconnected


@dataclass(frozen=True)
class StreamLimits:
    """Bounds and timeouts of a streamed motion, fixed at its start; a streamed task has them in place of orders."""

    bounds: MotionBounds = DEFAULT_MOTION_BOUNDS
    silence: float = 0.2  #: time without a message after which the tip comes to rest [s]
    end: float = 2.0  #: time without a message after which the motion ends [s]
    #: bounds of the streamed direction's angular velocity and acceleration [rad/s], [rad/s^2]
    turning: MotionBounds = DEFAULT_TURN_BOUNDS


class StreamedMotion:
    """Motion of a run whose setpoints a client streams."""

    def __init__(self, limits: StreamLimits, start: float, period: float, pointing: Array | None = None) -> None:
        """Start the motion at `start` [s]; a tick takes a `period` [s].

        `pointing` (3,) is the tip's direction at the start; None if the direction is not controlled.
        """
        self._limits, self._period = limits, period
        self._tip = StreamedTip(limits.bounds, limits.turning, pointing)
        # Time of the newest request by its sender, and time at which it arrived; at first the start of the motion [s].
        self._newest = self._received = start

    def order(self, now: float, blind: float, request: StreamRequest | None) -> Setpoint | None:
        """Return the setpoint of this tick; None after the end of the motion.

        Args:
            now: time [s].
            blind: time without a measurement of the tip [s]; above 0 the tip comes to rest.
            request: latest setpoint request, None before the first one. After a disconnect of the client the tip comes
                to rest and the motion ends.
        """
        setpoint = None if request is None else request.setpoint
        if setpoint is not None and setpoint.time > self._newest:
            self._newest, self._received = setpoint.time, now
        silent = now - self._received
        rests = self._tip.speed < REST_SPEED_M_S and self._tip.turning < REST_TURN_RAD_S
        if (request is not None and setpoint is None and rests) or silent > self._limits.end:
            return None
        return self._tip.advance(now, None if blind > 0.0 or silent > self._limits.silence else setpoint, self._period)


#: Time without a tracker frame after which the outer loop's correction is frozen [s]: four periods of the tracker.
FREEZE_AFTER_S = 0.1


class TimedOrders(Protocol):
    """Interface of orders that are known in advance as a function of time."""

    def at(self, time: float) -> Setpoint | JointMotion:
        """Return the order at `time` [s] since the motion's start."""
        ...


@dataclass(frozen=True)
class TimedMotion:
    """Motion of a run whose orders are known in advance."""

    orders: TimedOrders
    start: float  #: time at which the motion starts [s]

    def order(
        self,
        now: float,
        blind: float,
        request: StreamRequest | None = None,  # noqa: ARG002
    ) -> Setpoint | JointMotion:
        """Return this tick's order; without frames the setpoint keeps the position at the last frame."""
        time = now - self.start
        order = self.orders.at(time)
        if blind == 0.0 or not isinstance(order, Setpoint):
            return order
        last = self.orders.at(max(0.0, time - blind))
        return last._replace(velocity=order.velocity) if isinstance(last, Setpoint) else order


#: Time after which a jog that is not renewed ends [s]: its button was released or its client is gone.
JOG_TIMEOUT_S = 0.3
#: Quantity that a jog moves: the joints, the tip's position, or the tip's direction at constant position.
Space = Literal["joints", "tip", "direction"]
#: Quantity that a jog of the control loop moves; it may also move the joints toward a pose.
JogSpace = Space | Literal["pose"]
#: Rate at which the remaining distance to a streamed pose decays [1/s]. It is far below the inverse of the delay from
#: a command to the measured joints (0.05 s), so that the joints do not overshoot.
STREAM_RATE_HZ = 6.0


class JogMotion:
    """Motion that lasts while a client renews its request: a jog by a button, or joints that follow streamed poses."""

    def __init__(self, space: JogSpace, request: Array, now: float, pointing: Array | None) -> None:
        """Start at `now` [s] with a velocity of `space` or a pose of the joints (n,); see `ControlLoop.jog`.

        `pointing` (3,) is the present direction of the tip, needed for a jog of the direction.
        """
        self._space, self._request, self._renewed = space, request, now
        self._offset = np.zeros(3)  # displacement of the tip's setpoint since the start [m]
        # Desired direction of the tip; None: keep the direction of the start.
        self._direction = pointing if space == "direction" else None

    def renew(self, space: JogSpace, request: Array, now: float) -> bool:
        """Renew the jog with a request; return False if `space` differs, because another space needs a new jog."""
        if space != self._space:
            return False
        self._request, self._renewed = request, now
        return True

    def order(self, now: float, period: float, joints: Array, top: Array) -> JointMotion | Setpoint | None:
        """Return this tick's joint velocities or setpoint; None after the client has stopped renewing the jog.

        `joints` (n,) are the present joint positions [rad or m], and `top` (n,) the top speeds [rad/s or m/s].
        """
        if now - self._renewed > JOG_TIMEOUT_S:
            return None
        if self._space == "joints":
            return JointMotion(self._request)
        if self._space == "pose":
            return JointMotion(_toward((self._request - joints) / top, STREAM_RATE_HZ, 1.0) * top)
        if self._direction is not None:
            self._direction = rotated(self._direction, period * self._request)
            return Setpoint(self._offset, np.zeros(3), self._direction, self._request)
        self._offset = self._offset + period * self._request
        return Setpoint(self._offset, self._request)


def _toward(distance: Array, rate: float, share: float) -> Array:
    """Return velocities (n,) that close distances (n,) together; both are in units of the joints' largest speeds.

    The distances decay at `rate` [1/s] near their end, and the longest is closed at most at `share` of the top speed.
    """
    return distance * min(rate, share / max(np.abs(distance).max(), 1e-12))


class Phase(IntEnum):
    """Phase of a run; telemetry contains its number."""

    NONE = 0
    APPROACHING = 1  #: the joints move to the start pose
    SETTLING = 2  #: the robot rests: the sensors are tared and the start tip is measured
    MOVING = 3  #: the motion itself is executed
    JOGGING = 4  #: the operator jogs the robot


@dataclass(frozen=True)
class MotionTask:
    """Motion for the control loop to execute, with its controller and margins."""

    controller: Controller
    orders: TimedOrders | StreamLimits  #: orders that are known in advance, or limits of a motion that a client streams
    duration: float  #: duration of the motion after its preparation [s]
    start: Array | None = None  #: joints (n,) to start from; None: their present position
    margins: Margins | None = None  #: margins against a snap; None: those of the station
    rests: bool = True  #: rest for tare and start tip before the motion; False: end at the start pose
    loaded: bool = False  #: a known load may hang at the tip: the tare removes it, and the bound of the force counts it
    run: int = 0  #: number of the run that the motion belongs to; 0: none

    @property
    def follow(self) -> FollowMotion | None:
        """Motion that follows a target; None if the orders define the motion."""
        return self.orders.follow if isinstance(self.orders, Orders) else None

    @property
    def press(self) -> Press | None:
        """Desired force of the tip; None if the motion controls the position only."""
        return self.orders.press if isinstance(self.orders, Orders) else None

    def approach(self, joints: Array) -> Array | None:
        """Return the joint velocities (n,) [rad/s or m/s] from `joints` (n,) toward the start pose; None after arrival.

        All joints arrive together.
        """
        if self.start is None:
            return None
        top = self.controller.limits.speed
        distance = (self.start - joints) / top
        if np.abs(distance).max() <= ARRIVAL_TOLERANCE:
            return None
        return _toward(distance, APPROACH_RATE_HZ, SPEED_SHARE) * top


@dataclass(frozen=True)
class Progress:
    """Progress of a task that the control loop executes."""

    task: MotionTask
    phase: Phase
    settle_start: float = 0.0  #: start of the phase SETTLING [s]

    @property
    def motion_start(self) -> float:
        """Time at which the motion itself starts [s]; known from SETTLING on."""
        return self.settle_start + SETTLE_S + AVERAGE_S
