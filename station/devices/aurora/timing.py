"""Measurement times of frames from the frame numbers, and detection of impossible jumps of a coil."""

import math

#: Longest time for which a coil may have moved since its last good position, in the test for jumps: two frames [s].
MAX_MOTION_TIME_S = 0.05


class FrameClock:
    """Converts frame numbers to host time, by the lower envelope of the arrival times.

    A reply can be late but never early. Therefore the smallest difference between the arrival of a reply and the time
    since frame 0 is the best estimate. This estimate may rise slowly, because the two clocks drift apart.
    """

    def __init__(self, rate: float, drift: float = 5e-4, tolerance: float = 1.5, confirm: int = 5) -> None:
        """Set frame rate [1/s], clock drift [s/s], tolerance [frames], and consistent outliers until a restart."""
        self._rate, self._drift, self._tolerance, self._confirm = rate, drift, tolerance / rate, confirm
        self.restart()

    def restart(self) -> None:
        """Discard the estimate, because the unit may restart its frame count."""
        self._frame, self._arrival, self._offset, self._time = -1, 0.0, math.nan, -math.inf
        self._doubts, self._doubted = 0, (0, 0.0)

    def soonest(self, frame: int, arrival: float) -> float | None:
        """Return the earliest possible arrival of the reply with `frame` [s]; None if the number is implausible."""
        offset = arrival - frame / self._rate
        if math.isnan(self._offset):
            return self._anchor(frame, arrival)
        envelope = self._offset + self._drift * (arrival - self._arrival)
        if frame <= self._frame or not -self._tolerance <= offset - envelope <= 1.0:
            return self._doubt(frame, arrival)
        self._doubts = 0
        self._frame, self._arrival, self._offset = frame, arrival, min(offset, envelope)
        self._time = max(self._offset + frame / self._rate, self._time + 1e-6)
        return self._time

    def _anchor(self, frame: int, arrival: float) -> float:
        self._frame, self._arrival, self._offset = frame, arrival, arrival - frame / self._rate
        self._time = max(arrival, self._time + 1e-6)
        self._doubts = 0
        return self._time

    def _doubt(self, frame: int, arrival: float) -> float | None:
        """Count frames that are consistent with one another but not with the clock: the unit restarted its count."""
        frames, time = frame - self._doubted[0], arrival - self._doubted[1]
        if self._doubts and frames == 0:
            return None  # a repetition: the frame was requested again before the next frame was measured
        agrees = frames > 0 and abs(time - frames / self._rate) <= self._tolerance
        self._doubts = self._doubts + 1 if self._doubts and agrees else 1
        self._doubted = (frame, arrival)
        return self._anchor(frame, arrival) if self._doubts >= self._confirm else None


class JumpGate:
    """Rejects positions that a coil cannot have reached since its last good position."""

    def __init__(self, fastest: float, jitter: float, confirm: int) -> None:
        self._fastest, self._jitter, self._confirm = fastest, jitter, confirm
        self._last: tuple[float, tuple[float, ...]] | None = None
        self._suspect: tuple[float, tuple[float, ...]] | None = None
        self._agreeing = 0

    def passes(self, time: float, position: tuple[float, ...]) -> bool:
        """Return whether `position` [mm] at `time` [s] is plausible."""
        here = (time, position)
        if not self._near(self._last, here):
            self._agreeing = self._agreeing + 1 if self._suspect and self._near(self._suspect, here) else 1
            self._suspect = here
            if self._agreeing < self._confirm:
                return False
        self._last, self._suspect = here, None
        return True

    def _near(self, before: tuple[float, tuple[float, ...]] | None, here: tuple[float, tuple[float, ...]]) -> bool:
        if before is None:
            return True
        # The limited time prevents that a distant position is accepted at once after a long gap.
        reach = self._jitter + self._fastest * min(max(0.0, here[0] - before[0]), MAX_MOTION_TIME_S)
        return math.dist(before[1], here[1]) <= reach
