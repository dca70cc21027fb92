"""When a frame was measured, by its number, and whether its position can follow the last one."""

import math

#: The way of a coil since its last good position counts for this long at most: two frames [s].
LONGEST_MOVE = 0.05


class FrameClock:
    """Host time from frame numbers: the lower envelope of arrival times.

    A reply can be late but never early, so the smallest difference between arrival and frame number
    is nearest to the truth. It may rise slowly, because the two clocks drift apart.
    """

    def __init__(self, rate: float, drift: float = 5e-4, tolerance: float = 1.5, confirm: int = 5) -> None:
        """Rate [1/s], drift between the clocks [s/s], tolerance [frames], doubtful frames that make a new start."""
        self._rate, self._drift, self._tolerance, self._confirm = rate, drift, tolerance / rate, confirm
        self.restart()

    def restart(self) -> None:
        """Forget everything: the unit may count anew."""
        self._frame, self._arrival, self._offset, self._time = -1, 0.0, math.nan, -math.inf
        self._doubts, self._doubted = 0, (0, 0.0)

    def soonest(self, frame: int, arrival: float) -> float | None:
        """When the reply with `frame` could have arrived soonest [s]; None when the number cannot be right."""
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
        """Frames that agree with one another but not with the clock: the unit has begun to count anew."""
        frames, time = frame - self._doubted[0], arrival - self._doubted[1]
        if self._doubts and frames == 0:
            return None  # asked for again before the next one
        agrees = frames > 0 and abs(time - frames / self._rate) <= self._tolerance
        self._doubts = self._doubts + 1 if self._doubts and agrees else 1
        self._doubted = (frame, arrival)
        return self._anchor(frame, arrival) if self._doubts >= self._confirm else None


class JumpGate:
    """Refuses positions that a coil cannot have reached since the last good one."""

    def __init__(self, fastest: float, jitter: float, confirm: int) -> None:
        self._fastest, self._jitter, self._confirm = fastest, jitter, confirm
        self._last: tuple[float, tuple[float, ...]] | None = None
        self._suspect: tuple[float, tuple[float, ...]] | None = None
        self._agreeing = 0

    def passes(self, time: float, position: tuple[float, ...]) -> bool:
        """Whether to believe `position` [mm] at `time` [s]."""
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
        # However long it was not seen, it is not believed to be somewhere else at once.
        reach = self._jitter + self._fastest * min(max(0.0, here[0] - before[0]), LONGEST_MOVE)
        return math.dist(before[1], here[1]) <= reach
