"""Monitor of the tracker's frames: whether the observer can use them, and how much they scatter.

A frame that arrives moves the tip only if the observer uses it. The observer uses no frame that is older than its
history, and rejects one that is far from the expected tip for the configured noise. Without used frames the tip follows
the model alone, so a motion that the observer corrects ends.

The noise is measured by the fourth differences of the tip, in which motions up to some 3 Hz cancel. Each has the
variance 70 sigma^2 in each axis; single jumps do not change their median. The second differences, of the tip and of
measured minus model's tip, show whether the model moves from frame to frame while the tip does not: friction reverses
the forces at the sensors when the joints reverse, so joints and forces can sustain an oscillation that moves the tip
little.
"""

import math
from collections import deque

import numpy as np

from core.control.observer import REACQUIRE_FRAMES, Observer, ObserverState
from core.robot.robot import Array

#: Number of newest frames that are judged: 1 s at 40 Hz.
JUDGED_FRAMES = 40
#: Largest number of frames in a row that the observer does not use; after a jump it uses the last of them again.
MAX_UNUSED = REACQUIRE_FRAMES + 2
#: Smallest share of the judged frames that the observer must use.
LEAST_USED = 0.5
#: Noise above which it is named, and above which a motion ends, relative to the observer's noise.
NAMED_NOISE, LARGEST_NOISE = 3.0, 8.0
#: Median length of a vector of three normal numbers with the standard deviation 1.
MEDIAN_LENGTH = 1.538


def scatter(tips: Array, order: int) -> float:
    """Return the standard deviation of the noise in each axis [m] from the differences of tips (frames, 3) [m]."""
    lengths = np.linalg.norm(np.diff(tips, order, axis=0), axis=1)
    return float(np.median(lengths)) / (math.sqrt(math.comb(2 * order, order)) * MEDIAN_LENGTH)


class TrackerMonitor:
    """Monitor of the newest tracker frames; the control loop calls `update` with every frame."""

    def __init__(self) -> None:
        #: Measured tip, and its difference to the model (2, 3) [m], of the newest frames.
        self._tips: deque[Array] = deque(maxlen=JUDGED_FRAMES + 4)
        self._used: deque[bool] = deque(maxlen=JUDGED_FRAMES)  # since the start of the present motion
        self._unused = 0  # number of newest frames in a row that were not used
        self._age = 0.0  # age of the newest frame when it arrived [s]
        self._observer: Observer | None = None
        self._change, self._apart = 0.0, 0.0  # motion of the tip, and of its difference to the model, in each axis [m]
        self.noise = 0.0  #: standard deviation of the frames in each axis [m]; 0 until there are enough frames

    def update(self, observer: Observer, observed: ObserverState, tip: Array, age: float) -> None:
        """Add a frame after the tick in which it arrived.

        Args:
            observer: observer of the controller.
            observed: state of the observer after this tick.
            tip: tip (3,) in the frame [m].
            age: time since the frame was measured [s].
        """
        ticks = len(observed.tips)
        back = min(round(age / observer.period), ticks - 1)
        self._tips.append(np.array([tip, tip - observed.tips[(observed.newest - back) % ticks]]))
        self._used.append(observed.used)
        self._unused = 0 if observed.used else self._unused + 1
        self._age, self._observer = age, observer
        if len(self._tips) > JUDGED_FRAMES:
            tips, apart = np.array(self._tips).transpose(1, 0, 2)
            self.noise, self._change, self._apart = scatter(tips, 4), scatter(tips, 2), scatter(apart, 2)

    def begin(self) -> None:
        """Prepare for a motion: only frames that arrive in it count as used or not used."""
        self._used.clear()
        self._unused = 0

    @property
    def warning(self) -> str:
        """Warning about noise that is larger than expected; empty without one."""
        observer = self._observer
        if observer is None or self.noise <= NAMED_NOISE * observer.noise:
            return ""
        return f"{self._scatter(observer)}: {_CHECK}"

    def check(self) -> str:
        """Return why a motion must end that the tracker corrects, in one line; empty if it may continue."""
        observer, count = self._observer, len(self._used)
        if observer is None:
            return ""
        few = self._unused > MAX_UNUSED or (count == JUDGED_FRAMES and sum(self._used) < LEAST_USED * count)
        if few and self._age > observer.longest_age:
            return (
                f"the tracker's frames arrive {1e3 * self._age:.0f} ms after their measurement, and only frames up to"
                f" {1e3 * observer.longest_age:.0f} ms can be used: check what delays them (cable, hub, other programs)"
            )
        # Frames with little noise are rejected only while a load moves the tip quickly, and then used again.
        largest = (NAMED_NOISE if few else LARGEST_NOISE) * observer.noise
        if self.noise > largest:
            return f"{self._scatter(observer)}, so they cannot correct the tip: {_CHECK}"
        if self._apart > max(largest, 2.0 * self._change):
            return (
                f"the model's tip oscillates by {1e3 * self._apart:.2g} mm from frame to frame, but the tracker's by"
                f" {1e3 * self._change:.2g} mm: joints and forces sustain an oscillation, probably by friction in the"
                " tubes; use a lower controller.filter_bandwidth (1 Hz or the default)"
            )
        return ""

    def _scatter(self, observer: Observer) -> str:
        return f"the tracker's frames scatter by {1e3 * self.noise:.2g} mm (expected {1e3 * observer.noise:.2g} mm)"


_CHECK = "move metal, motors and power supplies away from the tracker, and check the coil and its cable"
