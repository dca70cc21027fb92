"""Which rows are a run's: all up to the end of its motion, however late somebody says that it has ended.

When a motion is over its load is let go, on a virtual lab at once: what the tip does then says nothing about the run.
"""

from core.robot.robot import Array
from station.control.task import Phase
from station.control.telemetry import Channels

#: What a run does; a jog is none.
OF_A_RUN = (Phase.APPROACHING, Phase.SETTLING, Phase.MOVING)


class RunRows:
    """Looks at the rows of one run, block after block."""

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._begun = False
        self.over = False  #: the run has ended, and its rows with it
        self.motion_start: float | None = None  #: time of the first row of the motion itself [s]

    def take(self, rows: Array) -> Array:
        """Those of the next rows (n, channels) that belong to the run, or come before it: (m, channels)."""
        if self.over:
            return rows[:0]
        phases = self._channels.of(rows, "phase")[:, 0]
        for number, phase in enumerate(phases.tolist()):
            if phase in OF_A_RUN:
                self._begun = True
                if phase == Phase.MOVING and self.motion_start is None:
                    self.motion_start = float(rows[number, 0])
            elif self._begun:
                self.over = True
                return rows[:number]
        return rows
