"""A target that moves: what is known of it from the tracker's frames, and the setpoint that follows it.

It is watched from the first frame on, so that its rhythms are known before a motion begins. The setpoint is led: it
goes where the target will be when the velocity that is asked for now works at the tip.
"""

from typing import NamedTuple

import numpy as np

from core.control.predictor import Known, NewestFrame, Place, Predictor, Waves
from core.control.pursuit import Pursuit
from core.control.step import Controller
from core.control.trajectories import Setpoint
from core.robot.robot import Array
from station.config.motions import FollowMotion
from station.control.states import RefusedError
from station.control.telemetry import TARGET
from station.devices.interfaces import Severity, TipReading, Trouble, Truth

#: Without a frame of it for so long a target is lost, and the tip comes to rest [s].
LOST = 0.25
#: After so long what was known of it is worth nothing [s].
FORGOTTEN = 5.0


class Following(NamedTuple):
    """A run that follows."""

    motion: FollowMotion
    pursuit: Pursuit
    period: float  #: of the loop [s]
    lead: float  #: from a command until it works at the tip [s]
    origin: Array  #: (3,) tip at the start, where setpoints count from [m]
    offset: Array  #: (3,) of the tip from the target [m]


class Target:
    """The target, whether a run follows it or not."""

    def __init__(self) -> None:
        self._predictors: tuple[Predictor, Predictor] = (NewestFrame(), Waves())
        self._known: list[Known] = []  # of each predictor, once a frame has come
        self._seen = -np.inf  # when the newest frame with it has come [s]
        self._now = 0.0
        self._new = False
        self._following: Following | None = None
        self._setpoint = Place(np.zeros(3), np.zeros(3))

    def see(self, now: float, frame: TipReading | None) -> None:
        """What the tracker has told at `now` [s]."""
        target = None if frame is None else frame.target
        # One that is no number is not seen.
        self._now, self._new = now, target is not None and bool(np.isfinite(target).all())
        if frame is None or target is None or not self._new:
            return
        goes_on = self._known and 0.0 < frame.time - self._known[0].time < FORGOTTEN
        self._known = [
            predictor.update(self._known[which], target, frame.time) if goes_on else predictor.start(target, frame.time)
            for which, predictor in enumerate(self._predictors)
        ]
        self._seen = now

    @property
    def missing(self) -> str:
        """Why nothing can be followed now; empty when it can."""
        if self._now - self._seen <= LOST:
            return ""
        if np.isinf(self._seen):
            return (
                f"target: has not been seen yet (more than {LOST:g} s); name its coil in devices.tracker.target, or"
                " bring it into the tracker's volume"
            )
        return (
            f"target: not seen for {self._now - self._seen:.1f} s (more than {LOST:g} s); bring it back into the"
            " tracker's volume"
        )

    def follow(self, motion: FollowMotion, controller: Controller, tip: Array) -> None:
        """Begin with the tip at rest at `tip` (3,) [m], where setpoints count from."""
        place = self._place(self._now)
        self._following = Following(
            motion,
            Pursuit(motion.max_speed, motion.max_acceleration),
            controller.period,
            controller.estimator.actuation.lead + motion.lag,
            tip,
            tip - place.position if motion.offset is None else np.array(motion.offset),
        )
        self._setpoint = Place(tip, np.zeros(3))

    def order(self) -> Setpoint:
        """The setpoint of this tick, from the tip at the start; at rest where it is while the target is lost.

        Raises:
            RefusedError: nothing is followed.
        """
        run = self._following
        if run is None:
            raise RefusedError("no target is followed; start a motion of kind 'follow'")
        lead = run.lead if run.motion.predict else 0.0
        goal = None
        if self._now - self._seen <= LOST:
            there = self._place(self._now + lead, predicted=run.motion.predict)
            goal = Place(there.position + run.offset, there.velocity)
        self._setpoint = run.pursuit.step(self._setpoint, goal, run.period)
        position, velocity = self._setpoint
        return Setpoint(position - lead * velocity - run.origin, velocity)

    def trouble(self) -> Trouble | None:
        """A target that has been lost for too long ends the run."""
        if self._following is None or self._now - self._seen <= self._following.motion.patience:
            return None
        return Trouble(Severity.HOLD, f"{self.missing}; the tip has come to rest, start again to go on")

    def end(self) -> None:
        """Nothing is followed any more."""
        self._following = None

    def numbers(self, truth: Truth | None) -> Array | None:
        """What telemetry has of it, in the order of its channels there: (14,); None: nothing is known of any."""
        if not self._known and (truth is None or truth.target is None):
            return None
        row = np.zeros(TARGET)
        if self._known:
            row[0], row[1] = self._new, self._following is not None
            row[2:5] = self._place(self._now, predicted=False).position
            row[5:8] = self._place(self._now).position
        if self._following is not None:
            row[8:11] = self._following.offset
        if truth is not None and truth.target is not None:
            row[11:14] = truth.target
        return row

    def _place(self, time: float, *, predicted: bool = True) -> Place:
        return self._predictors[predicted].at(self._known[predicted], time)


def load() -> None:
    """What is compiled is loaded before it counts: a first frame would otherwise stop a live loop for seconds."""
    for predictor in (NewestFrame(), Waves()):
        known = predictor.update(predictor.start(np.zeros(3), 0.0), np.zeros(3), 0.025)
        Pursuit(1.0, 1.0).step(predictor.at(known, 0.03), predictor.at(known, 0.03), 0.002)
