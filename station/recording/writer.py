"""Writer of one case's recording: rows, events and drawings for Foxglove, in chunks that are complete or absent."""

import contextlib
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array, Robot
from station.control.telemetry import Channel
from station.recording.data_section import (
    NO_ROWS,
    TELEMETRY_SCHEMA,
    TELEMETRY_TOPIC,
    DataSection,
    Rounding,
    RowFormat,
    Rows,
    Topic,
    WrittenMessage,
    message_records,
)
from station.recording.drawing import Drawing
from station.recording.foxglove import EVENTS_SCHEMA, EVENTS_TOPIC, RecordedEvent, event_json, json_topic
from station.recording.metadata import CHANNELS_RECORD, FORMAT, RUN_RECORD, channel_texts, texts, versions
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.summary import finish_file

#: Suffix of a recording that is being written, or whose writer was killed.
PARTIAL_SUFFIX = ".partial"
#: Suffix of a recording that could not be finished because the disk was full.
FULL_SUFFIX = ".full"
#: Number of drawings of the robot in a second. A drawing takes as much processor time as thirty rows.
DRAWINGS_PER_S = 10.0
#: Number of drawings that are created together, which halves their time because the code stays in the cache. A kill may
#: lose the latest drawings, but they can be computed from the rows.
DRAWINGS_PER_BATCH = 10
ROWS_CHANNEL, EVENT_CHANNEL, FIRST_DRAWING_CHANNEL = 1, 2, 3  #: ids of the MCAP topics
#: A block of rows is written when it has this number of rows or is this old [s]. A kill loses at most one block,
#: because a chunk that is given to the operating system survives.
BLOCK_ROWS = 500
FLUSH_INTERVAL_S = 0.2


class CaseWriter:
    """Writes `<case>.mcap`, under a provisional name until it is closed."""

    def __init__(
        self,
        path: Path,
        robot: Robot,
        channels: Sequence[Channel],
        metadata: Mapping[str, Any],
        pictures: float = DRAWINGS_PER_S,
    ) -> None:
        """Create the file under its provisional name.

        Args:
            path: final path of the file.
            robot: robot for the drawings.
            channels: channels of the rows.
            metadata: everything that the run depends on, by name; versions and the start time are added.
            pictures: number of drawings in a second of the run.

        Raises:
            RecordingError: the file cannot be created.
        """
        self.path = path
        self.channels = channels
        self.label: RunOutcome | None = None  #: outcome of the recording; None until its end
        self.started = time.time()  #: start of the recording [s since 1970]
        self._epoch: int | None = None  #: wall time at which the rows' clock was 0 [ns since 1970]
        self._format, self._rounding = RowFormat.compact(channels), Rounding(channels)
        self._drawing = Drawing(robot, channels, FIRST_DRAWING_CHANNEL)
        self._messages: list[WrittenMessage] = []
        self._rate = pictures
        self._picture: int | None = None  #: number of the period in which the latest drawing was made
        self._undrawn: list[tuple[Array, int]] = []  #: rows to draw with their wall times
        self._rows = 0
        self._section: DataSection | None = None
        topics = (
            Topic(TELEMETRY_TOPIC, "ros1", TELEMETRY_SCHEMA, "ros1msg", self._format.definition),
            json_topic(EVENTS_TOPIC, EVENTS_SCHEMA),
            *self._drawing.topics,
        )
        run = {"format": FORMAT, "started": self.started, "versions": versions(), **metadata}
        try:
            self._section = DataSection(
                self._partial, {RUN_RECORD: texts(run), CHANNELS_RECORD: channel_texts(self._format)}, topics
            )
        except OSError as error:
            raise RecordingError(f"{path}: cannot be recorded: {error.strerror}") from None

    @property
    def _partial(self) -> Path:
        return self.path.with_name(self.path.name + PARTIAL_SUFFIX)

    def event(self, event: RecordedEvent) -> None:
        """Record an event of the run; it is written together with the next rows."""
        stamp = self._start(event.time) + round(1e9 * event.time)
        self._messages.append(WrittenMessage(EVENT_CHANNEL, stamp, event_json(event, stamp)))

    def write(self, rows: Array) -> None:
        """Write rows (n, channels) and the events since the last call; both survive a kill of this process.

        Computed channels are rounded, see `Rounding`.

        Raises:
            RecordingError: the rows cannot be written; the recording has ended and is labelled incomplete.
        """
        if self._section is None:
            raise RecordingError(f"{self.path}: the recording has ended")
        stamps = self._stamps(rows[:, 0])
        self._undrawn += [(rows[number].copy(), int(stamps[number])) for number in self._pictures(rows[:, 0])]
        if len(self._undrawn) >= DRAWINGS_PER_BATCH:
            self._draw()
        packed = self._format.pack(self._rounding.rounded(rows))
        self._put(self._section, message_records(packed, stamps, ROWS_CHANNEL, self._rows))
        self._rows += len(rows)

    def close(self, label: RunOutcome, cause: str = "", **more: Any) -> None:
        """Finish the file and give it its final name.

        Args:
            label, cause: outcome of the run and its reason.
            more: further values that are known only at the end.

        Raises:
            RecordingError: the disk is full. If the remaining rows do not fit, the recording is labelled incomplete. If
                the end of the file does not fit, the next recovery finishes it.
        """
        if self._section is None:
            return
        if label is not RunOutcome.INCOMPLETE:
            self._draw()
            self._put(self._section, NO_ROWS)
        section, self._section = self._section, None
        self.label = label
        result = {"label": label, "cause": cause, "ended": time.time(), **more}
        try:
            section.cut()
            finish_file(section.file, texts(result))
            section.path.rename(self.path)
        except OSError as error:
            if label is RunOutcome.INCOMPLETE:
                section.path.rename(self.path.with_name(self.path.name + FULL_SUFFIX))
            raise RecordingError(f"{self.path}: the recording cannot be finished: {error.strerror}") from None
        finally:
            section.close()  # unlocks the file: only now a recovery may take it

    def _put(self, section: DataSection, rows: Rows) -> None:
        """Write rows together with the events and drawings that are pending."""
        try:
            section.write_chunk(rows, ROWS_CHANNEL, self._messages)
        except OSError as error:
            problem = f"{self.path}: the recording cannot be continued: {error.strerror}"
            with contextlib.suppress(RecordingError):  # the caller reports the first error
                self.close(RunOutcome.INCOMPLETE, problem)
            raise RecordingError(problem) from None
        self._messages = []

    def _draw(self) -> None:
        for row, stamp in self._undrawn:
            self._messages += self._drawing.messages(row, stamp)
        self._undrawn = []

    def _stamps(self, times: Array) -> NDArray[np.uint64]:
        """Convert the times of rows to wall times (n,) [ns since 1970]."""
        if len(times) == 0:
            return np.empty(0, np.uint64)
        return (1e9 * times + 0.5).astype(np.int64).astype(np.uint64) + np.uint64(self._start(float(times[-1])))

    def _pictures(self, times: Array) -> list[int]:
        """Return the indices of the rows to draw: the first row in each period of the drawings."""
        periods = (self._rate * times + 1e-6).astype(np.int64)
        before, drawn = self._picture, list[int]()
        for number, period in enumerate(periods.tolist()):
            if period != before:
                before = period
                drawn.append(number)
        self._picture = before
        return drawn

    def _start(self, moment: float) -> int:
        """Return the wall time at which the rows' time was 0, computed from the first known time [ns since 1970]."""
        if self._epoch is None:
            self._epoch = time.time_ns() - round(1e9 * moment)
        return self._epoch


class CaseRecorder:
    """Records one case in the process that runs it; its memory use does not grow with the length of the run."""

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
