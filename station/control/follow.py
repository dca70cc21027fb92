"""Target following: estimate of a moving target from tracker frames, and the setpoint that follows it.

The target is tracked from the first frame on, so that the periods of its motion are known before a run starts. The
setpoint is the target's predicted position at the time when a velocity commanded now takes effect at the tip.
"""

from typing import NamedTuple

import numpy as np

from core.control.controller_settings import Controller
from core.control.predictor import NewestFrame, Predictor, PredictorState, TargetState, Waves
from core.control.setpoint_request import MotionBounds
from core.control.trajectories import Setpoint
from core.robot.robot import Array
from station.config.motions import FollowMotion
from station.control.states import RefusedError
from station.control.task import StreamRequest
from station.devices.interfaces import DeviceFault, GroundTruth, Severity, TipReading

#: Time without a tracker frame of the target after which the tip comes to rest [s].
TARGET_LOST_S = 0.25
#: Time without a tracker frame of the target after which the predictors restart [s].
TARGET_FORGOTTEN_S = 5.0


class Following(NamedTuple):
    """Parameters of a run that follows the target."""

    motion: FollowMotion
    bounds: MotionBounds
    period: float  #: period of the control loop [s]
    lead_time: float  #: time from a command to its effect at the tip [s]
    origin: Array  #: (3,) tip at the start, origin of the setpoints [m]
    offset: Array  #: (3,) desired position of the tip relative to the target [m]


class TargetValues(NamedTuple):
    """Values of the target that telemetry records; None: unknown."""

    new: bool = False  #: whether a new frame of the target has arrived
    followed: bool = False  #: whether the tip follows the target
    measured: Array | None = None  #: (3,) target in its last frame [m]
    predicted: Array | None = None  #: (3,) target now, predicted from its frames [m]
    offset: Array | None = None  #: (3,) tip minus target while it is followed [m]
    true: Array | None = None  #: (3,) true target of a virtual lab [m]


class TargetTrack:
    """Target that the tracker measures, and the motion of a run that follows it."""

    def __init__(self) -> None:
        self._predictors: tuple[Predictor, Predictor] = (NewestFrame(), Waves())
        self._known: list[PredictorState] = []  # state of each predictor, after the first frame
        self._last_frame = -np.inf  # arrival time of the newest frame with the target [s]
        self._now = 0.0
        self._new = False
        self._following: Following | None = None
        self._setpoint = TargetState(np.zeros(3), np.zeros(3))

    def update(self, now: float, frame: TipReading | None) -> None:
        """Update the predictors of the target with the tracker's reading at `now` [s]."""
        self._now, self._new = now, False
        target = None if frame is None else frame.target
        # Ignore a position of the target that is NaN or infinite.
        if frame is None or target is None or not np.isfinite(target).all():
            return
        self._new = True
        ongoing = self._known and 0.0 < frame.time - self._known[0].time < TARGET_FORGOTTEN_S
        self._known = [
            predictor.update(self._known[which], target, frame.time) if ongoing else predictor.start(target, frame.time)
            for which, predictor in enumerate(self._predictors)
        ]
        self._last_frame = now

    @property
    def missing(self) -> str:
        """Reason why the target cannot be followed now; empty if it can."""
        if self._now - self._last_frame <= TARGET_LOST_S:
            return ""
        if np.isinf(self._last_frame):
            return (
                "the target was not measured yet; name its coil in devices.tracker.target, or bring it into the volume"
                " of the tracker"
            )
        return (
            f"the target was not measured for {self._now - self._last_frame:.1f} s (more than {TARGET_LOST_S:g} s);"
            " bring it back into the tracker's volume"
        )

    def follow(self, motion: FollowMotion, controller: Controller, tip: Array) -> None:
        """Start to follow the target; the tip is at rest at `tip` (3,) [m], which is the origin of the setpoints."""
        target = self._target_at(self._now)
        self._following = Following(
            motion,
            MotionBounds(motion.max_speed, motion.max_acceleration),
            controller.period,
            controller.estimator.actuation.lead_time + motion.lag,
            tip,
            tip - target.position if motion.offset is None else np.array(motion.offset),
        )
        self._setpoint = TargetState(tip, np.zeros(3))

    def order(
        self,
        now: float,
        blind: float = 0.0,  # noqa: ARG002
        request: StreamRequest | None = None,  # noqa: ARG002
    ) -> Setpoint | DeviceFault:
        """Return this tick's setpoint relative to the start tip; the setpoint comes to rest while the target is lost.

        After the run's `patience` without the target, return a fault that ends the run.

        Raises:
            RefusedError: no target is followed.
        """
        run = self._following
        if run is None:
            raise RefusedError("no target is followed; start a motion of kind 'follow'")
        if now - self._last_frame > run.motion.patience:
            return DeviceFault(Severity.HOLD, f"{self.missing}; the tip has come to rest, start again to continue")
        lead_time = run.lead_time if run.motion.predict else 0.0
        goal = None
        if self._now - self._last_frame <= TARGET_LOST_S:
            there = self._target_at(self._now + lead_time, predicted=run.motion.predict)
            goal = TargetState(there.position + run.offset, there.velocity)
        self._setpoint = run.bounds.step(self._setpoint, goal, run.period)
        position, velocity = self._setpoint
        return Setpoint(position - lead_time * velocity - run.origin, velocity)

    def end(self) -> None:
        """End the motion that follows the target."""
        self._following = None

    def values(self, truth: GroundTruth | None) -> TargetValues | None:
        """Return the target's values in a row of telemetry; None if no target is known."""
        true = None if truth is None else truth.target
        if not self._known:
            return None if true is None else TargetValues(true=true)
        measured, predicted = (self._target_at(self._now, predicted=way).position for way in (False, True))
        offset = None if self._following is None else self._following.offset
        return TargetValues(self._new, offset is not None, measured, predicted, offset, true)

    def _target_at(self, time: float, *, predicted: bool = True) -> TargetState:
        return self._predictors[predicted].at(self._known[predicted], time)


def warm_up() -> None:
    """Compile the predictors before the loop runs: the first frame would otherwise stop a live loop for seconds."""
    for predictor in (NewestFrame(), Waves()):
        known = predictor.update(predictor.start(np.zeros(3), 0.0), np.zeros(3), 0.025)
        MotionBounds(1.0, 1.0).step(predictor.at(known, 0.03), predictor.at(known, 0.03), 0.002)
