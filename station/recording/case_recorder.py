"""Rows one at a time, as a loop has them, to a file in blocks."""

import time

import numpy as np

from core.robot.robot import Array
from station.recording.events import Event
from station.recording.label import Label
from station.recording.writer import CaseWriter

#: A block is written when it has so many rows, or when it is so old [s]: a kill loses no more.
BLOCK = 500
FLUSH = 0.2


class CaseRecorder:
    """Records one case in the process that runs it; memory stays the same however long it runs."""

    def __init__(self, writer: CaseWriter, width: int) -> None:
        self._writer = writer
        self._block = np.empty((BLOCK, width))
        self._filled = 0
        self._due = time.monotonic() + FLUSH

    def write(self, row: Array) -> None:
        """Add a row (channels,).

        Raises:
            RecordingError: the disk takes no more; what was written before stays, labelled incomplete.
        """
        self._block[self._filled] = row
        self._filled += 1
        if self._filled == BLOCK or time.monotonic() >= self._due:
            self._flush()

    def event(self, event: Event) -> None:
        """Note something that happened."""
        self._writer.event(event)

    def close(self, label: Label, cause: str = "") -> None:
        """Write what is left and finish the file; nothing when the disk has ended it before.

        Raises:
            RecordingError: the disk has no room for it.
        """
        if self._filled and self._writer.label is None:
            self._flush()
        self._writer.close(label, cause)

    def _flush(self) -> None:
        filled, self._filled = self._filled, 0
        self._writer.write(self._block[:filled])
        self._due = time.monotonic() + FLUSH
