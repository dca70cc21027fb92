"""Recorder for a control loop in the same process: it receives single telemetry rows and writes them in blocks."""

import time

import numpy as np

from core.robot.robot import Array
from station.recording.events import RecordedEvent
from station.recording.run_outcome import RunOutcome
from station.recording.writer import CaseWriter

#: A block of rows is written when it has this number of rows or is this old [s]. A kill loses at most one block.
BLOCK_ROWS = 500
FLUSH_INTERVAL_S = 0.2


class CaseRecorder:
    """Records one case in the process that runs it; the memory does not grow with the length of the run."""

    def __init__(self, writer: CaseWriter, width: int) -> None:
        self._writer = writer
        self._block = np.empty((BLOCK_ROWS, width))
        self._filled = 0
        self._due = time.monotonic() + FLUSH_INTERVAL_S

    def write(self, row: Array) -> None:
        """Add a telemetry row (channels,) to the recording.

        Raises:
            RecordingError: the disk is full. The rows before are kept, and the recording is labelled incomplete.
        """
        self._block[self._filled] = row
        self._filled += 1
        if self._filled == BLOCK_ROWS or time.monotonic() >= self._due:
            self._flush()

    def event(self, event: RecordedEvent) -> None:
        """Record an event of the run."""
        self._writer.event(event)

    def close(self, label: RunOutcome, cause: str = "") -> None:
        """Write the remaining rows and finish the recording, unless a full disk has already ended it.

        Raises:
            RecordingError: the disk is full.
        """
        if self._filled and self._writer.label is None:
            self._flush()
        self._writer.close(label, cause)

    def _flush(self) -> None:
        filled, self._filled = self._filled, 0
        self._writer.write(self._block[:filled])
        self._due = time.monotonic() + FLUSH_INTERVAL_S
