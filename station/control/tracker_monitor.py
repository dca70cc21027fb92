"""Monitor of the tracker's frames: whether the observer can use them, and how much they scatter.

A frame that arrives moves the tip only if the observer uses it. The observer uses no frame that is older than its
history, and rejects one that is far from the expected tip for the configured noise. Without used frames the tip follows
the model alone, so a motion that the observer corrects ends.

The noise is measured by the second differences e(i) - 2 e(i-1) + e(i-2) of measured minus model's tip, in which steady
errors and drifts cancel. Each has the variance 6 sigma^2 in each axis; single jumps do not change their median.
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


def scatter(differences: Array) -> float:
    """Return the standard deviation in each axis [m] of differences (frames, 3) of two tips [m]."""
    second = np.diff(differences, 2, axis=0)
    return float(np.median(np.linalg.norm(second, axis=1))) / (math.sqrt(6.0) * MEDIAN_LENGTH)


class TrackerMonitor:
    """Monitor of the newest tracker frames; the control loop calls `update` with every frame."""

    def __init__(self) -> None:
        self._differences: deque[Array] = deque(maxlen=JUDGED_FRAMES + 2)  # measured minus model's tip (3,) [m]
        self._used: deque[bool] = deque(maxlen=JUDGED_FRAMES)  # since the start of the present motion
        self._unused = 0  # number of newest frames in a row that were not used
        self._age = 0.0  # age of the newest frame when it arrived [s]
        self._observer: Observer | None = None
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
        self._differences.append(tip - observed.tips[(observed.newest - back) % ticks])
        self._used.append(observed.used)
        self._unused = 0 if observed.used else self._unused + 1
        self._age, self._observer = age, observer
        if len(self._differences) > JUDGED_FRAMES:
            self.noise = scatter(np.array(self._differences))

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
        if self.noise > (NAMED_NOISE if few else LARGEST_NOISE) * observer.noise:
            return f"{self._scatter(observer)}, so they cannot correct the tip: {_CHECK}"
        return ""

    def _scatter(self, observer: Observer) -> str:
        return f"the tracker's frames scatter by {1e3 * self.noise:.2g} mm (expected {1e3 * observer.noise:.2g} mm)"


_CHECK = "move metal, motors and power supplies away from the tracker, and check the coil and its cable"
