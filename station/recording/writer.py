"""One case on disk: rows, events and what Foxglove draws, in chunks that are whole or not there."""

import contextlib
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from core.robot.robot import Array, Robot
from station.control.telemetry import Channel
from station.recording.data_section import DataSection, Said, Topic
from station.recording.drawing import Drawing
from station.recording.events import SCHEMA as EVENTS_SCHEMA
from station.recording.events import TOPIC as EVENTS
from station.recording.events import Event, event_json
from station.recording.foxglove import json_topic
from station.recording.label import Label, RecordingError
from station.recording.metadata import CHANNELS, FORMAT, RUN, channel_texts, texts, versions
from station.recording.row_message import NO_ROWS, SCHEMA, TOPIC, Rows, definition, message_records
from station.recording.summary import finish_file

#: A file that is being written, or was when its writer was killed.
PARTIAL = ".partial"
#: A file that the disk had no room to finish.
FULL = ".full"
#: Pictures a second: one costs as much as thirty rows.
PICTURES = 10.0
#: They are drawn so many together, when the processor has the code at hand: that halves what they cost. A kill
#: may take the latest of them, which follow from the rows.
TOGETHER = 10
ROWS, EVENT, DRAWN = 1, 2, 3  #: topics by id


class CaseWriter:
    """Writes `<case>.mcap`, under a provisional name until it is closed."""

    def __init__(
        self,
        path: Path,
        robot: Robot,
        channels: Sequence[Channel],
        metadata: Mapping[str, Any],
        pictures: float = PICTURES,
    ) -> None:
        """Make the file.

        Args:
            path: its final name.
            robot: to be drawn.
            channels: of the rows.
            metadata: everything the run depends on, by name; versions and the start are added.
            pictures: drawn for each second of the run.

        Raises:
            RecordingError: it cannot be made.
        """
        self.path = path
        self.channels = channels
        self.label: Label | None = None  #: how it ended, once it has
        self.started = time.time()  #: [s] since 1970
        self._epoch: int | None = None  #: of the rows' own time, which may count from anywhere [ns] since 1970
        self._drawing = Drawing(robot, channels, DRAWN)
        self._said: list[Said] = []
        self._rate = pictures
        self._picture: int | None = None  #: period of the latest
        self._undrawn: list[tuple[Array, int]] = []  #: rows and wall times
        self._rows = 0
        self._section: DataSection | None = None
        topics = (
            Topic(TOPIC, "ros1", SCHEMA, "ros1msg", definition(channels)),
            json_topic(EVENTS, EVENTS_SCHEMA),
            *self._drawing.topics,
        )
        run = {"format": FORMAT, "started": self.started, "versions": versions(), **metadata}
        try:
            self._section = DataSection(self._partial, {RUN: texts(run), CHANNELS: channel_texts(channels)}, topics)
        except OSError as error:
            raise RecordingError(f"{path}: cannot be recorded: {error.strerror}") from None

    @property
    def _partial(self) -> Path:
        return self.path.with_name(self.path.name + PARTIAL)

    def event(self, event: Event) -> None:
        """Note something that happened; it goes with the next rows."""
        stamp = self._start(event.time) + round(1e9 * event.time)
        self._said.append(Said(EVENT, stamp, event_json(event, stamp)))

    def write(self, rows: Array) -> None:
        """Write rows (n, channels) and the events since the last time; they outlive this process from now on.

        Raises:
            RecordingError: the disk does not take them. The recording has ended and is labelled so.
        """
        if self._section is None:
            raise RecordingError(f"{self.path}: the recording has ended")
        stamps = self._stamps(rows[:, 0])
        self._undrawn += [(rows[number].copy(), int(stamps[number])) for number in self._pictures(rows[:, 0])]
        if len(self._undrawn) >= TOGETHER:
            self._draw()
        self._put(self._section, message_records(rows, stamps, ROWS, self._rows))
        self._rows += len(rows)

    def close(self, label: Label, cause: str = "", **more: Any) -> None:
        """Finish the file and give it its name.

        Args:
            label, cause: how the run ended.
            more: what else is known only at the end.

        Raises:
            RecordingError: the disk has no room for what is left, and the recording is labelled incomplete; or
                not for the end, and the next recovery finishes the file.
        """
        if self._section is None:
            return
        if label is not Label.INCOMPLETE:
            self._draw()
            self._put(self._section, NO_ROWS)
        section, self._section = self._section, None
        self.label = label
        result = {"label": label, "cause": cause, "ended": time.time(), **more}
        try:
            section.close()
            finish_file(section.path, texts(result), verify=False)
            section.path.rename(self.path)
        except OSError as error:
            if label is Label.INCOMPLETE:
                section.path.rename(self.path.with_name(self.path.name + FULL))
            raise RecordingError(f"{self.path}: the recording cannot be finished: {error.strerror}") from None

    def _put(self, section: DataSection, rows: Rows) -> None:
        """Rows, and all that was said meanwhile."""
        try:
            section.write_chunk(rows, ROWS, self._said)
        except OSError as error:
            problem = f"{self.path}: the disk takes no more of the recording: {error.strerror}"
            with contextlib.suppress(RecordingError):  # the reason is the one above
                self.close(Label.INCOMPLETE, problem)
            raise RecordingError(problem) from None
        self._said = []

    def _draw(self) -> None:
        for row, stamp in self._undrawn:
            self._said += self._drawing.messages(row, stamp)
        self._undrawn = []

    def _stamps(self, times: Array) -> NDArray[np.uint64]:
        """Wall time (n,) [ns] of rows' times."""
        if len(times) == 0:
            return np.empty(0, np.uint64)
        return (1e9 * times + 0.5).astype(np.int64).astype(np.uint64) + np.uint64(self._start(float(times[-1])))

    def _pictures(self, times: Array) -> list[int]:
        """Which rows are to be drawn: the first of each period of the pictures."""
        periods = (self._rate * times + 1e-6).astype(np.int64)
        before, drawn = self._picture, list[int]()
        for number, period in enumerate(periods.tolist()):
            if period != before:
                before = period
                drawn.append(number)
        self._picture = before
        return drawn

    def _start(self, moment: float) -> int:
        """When the rows' time was 0, from the newest moment of the first that are heard of [ns] since 1970."""
        if self._epoch is None:
            self._epoch = time.time_ns() - round(1e9 * moment)
        return self._epoch
