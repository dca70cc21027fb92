"""Selection of a run's rows: all rows up to the end of its motion, even if the request to end the recording is late.

After the motion the load is removed, in a virtual lab at once. The tip then moves, and its motion is not part of the
run.
"""

from core.robot.robot import Array
from station.control.task import Phase
from station.control.telemetry import Channels

#: Phases that belong to a run; jogging a joint by hand does not.
RUN_PHASES = (Phase.APPROACHING, Phase.SETTLING, Phase.MOVING)


class RunRows:
    """Selects the rows of one run, block by block."""

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._started = False
        self.over = False  #: whether the run has ended; later rows do not belong to it
        self.motion_start: float | None = None  #: time of the first row in phase MOVING [s]

    def take(self, rows: Array) -> Array:
        """Return those rows of the next block (n, channels) that belong to the run or precede it: (m, channels)."""
        if self.over:
            return rows[:0]
        phases = self._channels.of(rows, "phase")[:, 0]
        for number, phase in enumerate(phases.tolist()):
            if phase in RUN_PHASES:
                self._started = True
                if phase == Phase.MOVING and self.motion_start is None:
                    self.motion_start = float(rows[number, 0])
            elif self._started:
                self.over = True
                return rows[:number]
        return rows
