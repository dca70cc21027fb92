"""Monitor that compares the tip of the tracker with the tip that stages and force sensors explain.

The tracker measures the tip X. The model knows the same tip F(q, f) from the stages' counts q and the measured force f.
The difference X - F changes slowly with pose and load, because the tubes differ from their description. Metal near the
tracker or a moved field generator changes it without a motion and without a force, and the outer loop would move the
tip by this change. A wrong force sensor bends only the model, which changes the difference, too.

Medians of `FRAMES` frames are compared with three references, which follow them with the time constants `FORGETS_S`.
The change of X - F is a contradiction if it exceeds `margins.unexplained`, the tracker's noise, shares of the largest
recent changes of deflection and setpoint, and what errors of the sensors' gain explain together. Without force sensors
a load is known only from the difference itself. The sum of the forces alone, as in the paper, is wrong by 0.3 N if the
tubes have friction.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from core.control.controller_settings import Controller
from core.control.step import Tick
from core.control.tip_force import FITS, MISFIT, QUALITY
from core.robot.robot import Array
from station.control.monitors import FORGETS_S as LONG_S
from station.control.tracker_monitor import scatter

#: Number of frames in a median: 0.22 s at 40 Hz. The fifth frame after a jump is the first one in the median, and the
#: observer uses a jump only after eight. A tap of 0.5 N differs in up to four, because force and tracker differ in lag.
FRAMES = 9
#: Number of the first medians whose mean is the reference: 0.5 s at 40 Hz.
MEANS = 20
#: Change that is no contradiction, in standard deviations of the tracker's noise, or of a third of the present noise,
#: which contains that of the force. With `margins.unexplained` it is 1.8 mm.
NOISE_DEVIATIONS = 8.0
#: Time constants of the references [s], and shares of the change of deflection and setpoint that wrong tubes explain.
#: The first shows a jump during a path, the second a change under a constant load, the third a slow change. With tubes
#: within 8 % up to 0.28 of a deflection by 0.5 N and 0.2 of a path were found; friction releases 2 mm within 0.2 s.
FORGETS_S = np.array([0.5, 4.0, LONG_S])
LOADED_SHARES, TRAVEL_SHARES = np.array([0.8, 0.3, 0.3]), np.array([0.2, 0.16, 0.12])
#: Standard deviations of errors of gain and cross-talk: friction changes the readings by up to 17 N without a force.
GAIN_DEVIATIONS = np.array([0.5, 0.5, 1.0])


class ComparedTips(NamedTuple):
    """What the estimates of one tick know about the tip (positions (3,) [m])."""

    measured: Array  #: tip in the newest tracker frame
    loaded: Array  #: tip of the model with the measured force
    unloaded: Array  #: tip of the model without load
    setpoint: Array
    force: Array  #: measured force (3,) at the tip [N]
    readings: Array  #: readings (2 q, 3) of the sensors since the tare, relative to their ranges
    gain_error: float  #: displacement of the model's tip by errors of gain if readings change by their range [m]
    at_tip: bool  #: the sensors' moments belong to a force at the tip, not to a load on the tubes
    noise: float  #: standard deviation of the tracker's frames in each axis that the observer assumes [m]


def compared_tips(controller: Controller, tick: Tick, wrenches: Array) -> ComparedTips | None:
    """Return the tips after a tick with a new frame; None if the bench measures no load that could explain them.

    Args:
        controller: controller of the bench.
        tick: result of the tick.
        wrenches: readings (q, 6) of the sensors since the tare [N, N m].
    """
    if not (controller.senses and controller.estimator.load.moments):
        return None
    memory, estimate, errors = tick.memory, tick.memory.estimate, controller.estimator.load.errors
    readings = wrenches.reshape(-1, 2, 3) / np.array([errors.force_range, errors.moment_range])[:, None]
    gain_error = errors.gain * errors.force_range * float(np.linalg.norm(estimate.loaded.compliance[:3, :3], 2))
    return ComparedTips(
        memory.tip, estimate.loaded.tip, estimate.unloaded.tip, memory.origin + tick.setpoint.position, estimate.force,
        readings.reshape(-1, 3), gain_error,
        bool(estimate.known.load[QUALITY, MISFIT] <= FITS), controller.estimator.observer.noise,
    )  # fmt: skip


class ContradictionMonitor:
    """Monitor of one motion of the tip; the control loop calls `check` with every tracker frame."""

    def __init__(self, unexplained: float) -> None:
        """Prepare the monitor; `unexplained` is the change that is no contradiction without any noise [m]."""
        self._unexplained = unexplained
        #: Of the newest frames (4 + 2 q, 3): tracker minus loaded model, minus unloaded model; deflection; setpoint
        #: [m]; the sensors' relative readings.
        self._frames: deque[Array] = deque(maxlen=FRAMES)
        self._model, self._references = np.zeros((2, 3)), np.zeros((3, 0, 3))  # model at the last frame [m]; references
        self._medians = 0  # number of medians so far
        self._explained, self._time = np.zeros(3), 0.0  # changes that wrong tubes explain [m], time of a frame [s]

    def check(self, tips: ComparedTips | None, now: float, age: float) -> str:
        """Return why the motion must end, in one line; empty if it may continue.

        Args:
            tips: tips of a tick with a new frame; None: they cannot be compared.
            now: time of the tick [s].
            age: time since the frame was measured [s].
        """
        if tips is None:
            return ""
        since, bent = now - self._time, tips.loaded - tips.unloaded
        model = np.array([tips.loaded, tips.unloaded])
        # The model is compared at the time when the frame was measured.
        then = model + (min(age / since, 1.0) * (self._model - model) if self._frames else 0.0)
        self._model, self._time = model, now
        self._frames.append(np.array([*(tips.measured - then), bent, tips.setpoint, *tips.readings]))
        frames = np.array(self._frames)
        recent = np.median(frames, axis=0)
        if len(self._frames) < FRAMES:
            self._references = np.repeat(recent[None], len(FORGETS_S), axis=0)
            return ""
        # At first a reference is the mean of all medians: after a tare, the force has little filtering and much noise.
        self._medians += 1
        changes = recent - self._references
        part = np.clip(since / FORGETS_S, 1.0 / self._medians if self._medians < MEANS else 0.0, 1.0)
        self._references += part[:, None, None] * changes
        apart, by_tracker, by_force, travel = np.linalg.norm(changes[:, :4], axis=2).T
        read = GAIN_DEVIATIONS * tips.gain_error * np.linalg.norm(changes[:, 4:], axis=(1, 2))
        explained = LOADED_SHARES * by_force + TRAVEL_SHARES * travel + read
        if not tips.at_tip:  # a load on the tubes bends them in another way
            explained += np.linalg.norm(bent)
        self._explained = np.maximum(explained, (1.0 - part) * self._explained)
        noise = max(tips.noise, scatter(frames[:, 0], 2) / 3.0)
        bounds = self._unexplained + NOISE_DEVIATIONS * noise + self._explained
        which = int((apart - bounds).argmax())
        if apart[which] <= bounds[which]:
            return ""
        force = f"{float(np.linalg.norm(tips.force)):.2g} N"
        if by_tracker[which] < 0.5 * by_force[which]:
            return (
                f"the force sensors contradict the tracker: within {FORGETS_S[which]:g} s the measured force, now"
                f" {force}, has moved the model's tip by {1e3 * by_force[which]:.2g} mm, but the tracker shows"
                f" {1e3 * by_tracker[which]:.2g} mm: a wrong force sensor is more likely than a wrong tracker; check"
                " the sensors, their cables, and what touches the tubes, then zero the force"
            )
        return (
            f"the tracker contradicts stages and force sensors: within {FORGETS_S[which]:g} s its tip has moved by"
            f" {1e3 * apart[which]:.2g} mm against the model, but the measured force, {force}, and errors of the tubes"
            f" explain at most {1e3 * bounds[which]:.2g} mm: metal near the tracker, or a moved field generator or"
            " robot, is more likely than a load; remove the metal, or fasten both and calibrate the tracker."
            " margins.unexplained in the station's file sets another limit"
        )
