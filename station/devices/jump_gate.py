"""Test whether a position of a tracker has jumped."""

import math

#: Largest speed of the tip [mm/s], largest jitter of its position [mm], and number of consistent frames that confirm a
#: position beyond both; until then such a position counts as a jump.
MAX_COIL_SPEED, JITTER_MM, FRAMES_TO_ACCEPT_JUMP = 500.0, 2.0, 10
#: Longest time of motion since the last good position that the test assumes: two frames [s].
MAX_MOTION_TIME_S = 0.05


class JumpGate:
    """Rejects positions that the tip cannot have reached since its last good position."""

    def __init__(self) -> None:
        self._last: tuple[float, tuple[float, ...]] | None = None
        self._suspect: tuple[float, tuple[float, ...]] | None = None
        self._agreeing = 0

    def passes(self, time: float, position: tuple[float, ...]) -> bool:
        """Return whether `position` [mm] at `time` [s] is plausible."""
        here = (time, position)
        if not self._near(self._last, here):
            self._agreeing = self._agreeing + 1 if self._suspect and self._near(self._suspect, here) else 1
            self._suspect = here
            if self._agreeing < FRAMES_TO_ACCEPT_JUMP:
                return False
        self._last, self._suspect = here, None
        return True

    def _near(self, before: tuple[float, tuple[float, ...]] | None, here: tuple[float, tuple[float, ...]]) -> bool:
        if before is None:
            return True
        # Without the limit of the time any distant position would be accepted at once after a long gap.
        reach = JITTER_MM + MAX_COIL_SPEED * min(max(0.0, here[0] - before[0]), MAX_MOTION_TIME_S)
        return math.dist(before[1], here[1]) <= reach
