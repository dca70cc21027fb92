"""Reading of recordings: a whole case at once, or block by block if the case is larger than the memory."""

import json
import tempfile
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap.summary import Summary

from core.robot.robot import Array
from station.control.telemetry import Channel
from station.recording.chunks import DAMAGE, chunks_with, messages
from station.recording.data_section import TELEMETRY_TOPIC
from station.recording.foxglove import EVENTS_TOPIC, RecordedEvent, event_of
from station.recording.metadata import CHANNELS_RECORD, RUN_RECORD, is_later, row_format, texts, values_of
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.salvage import is_outcome, is_recording, salvage
from station.recording.summary import RESULT_RECORD, ends_intact
from station.recording.writer import FULL_SUFFIX, PARTIAL_SUFFIX
from station.regular_file import open_in

#: Largest number of rows from which the errors of a run are computed: every tick of half an hour. Of a longer run only
#: every n-th row is used.
MAX_SUMMARY_ROWS = 1_000_000
#: Largest number of gaps of a recording whose times are stated.
MAX_NAMED_GAPS = 10
#: Cause in a recording whose own outcome cannot be read.
END_DAMAGED = "the end of the recording is damaged or missing"


class CaseRecording(NamedTuple):
    """One recorded case of a run, in memory."""

    channels: tuple[Channel, ...]
    rows: Array  #: (ticks, channels)
    events: tuple[RecordedEvent, ...]
    metadata: Mapping[str, Any]  #: metadata of the writer: configuration, versions, seed, start
    label: RunOutcome
    cause: str  #: reason why the run is not complete
    stride: int = 1  #: n if `rows` has only every n-th tick
    epoch: int = 0  #: wall time at which the rows' time was 0 [ns since 1970]; 0 without rows
    gaps: "tuple[Gap, ...]" = ()  #: damaged rows that are missing

    def of(self, group: str) -> Array:
        """Return the columns of a channel group; `tip_measured` has (ticks, 3).

        Raises:
            RecordingError: the recording has no such channels.
        """
        return self.rows[:, columns(self.channels, group)]


class Gap(NamedTuple):
    """Rows of a recording that are damaged and were skipped."""

    rows: int
    after: float | None  #: time of the row before them [s]; None: they are the first rows
    before: float | None  #: time of the row after them [s]; None: they are the last rows


class CaseReader:
    """Recording that is open for reading; its rows are read on demand. Damaged chunks are skipped, see `gaps`."""

    def __init__(self, path: Path, recording: "IndexedFile") -> None:
        """Read everything in the recording except the rows.

        Raises:
            RecordingError: the file is damaged before its first row, of a later format, or not a recording of this
                program.
        """
        self._path, self._recording = path, recording
        with undamaged(path):
            written = recording.metadata
            self.metadata: Mapping[str, Any] = values_of(written[RUN_RECORD])
            if later := is_later(self.metadata):
                raise RecordingError(f"{path}: {later}")
            self._format = row_format(written[CHANNELS_RECORD])
            self.channels = tuple(self._format.channels)
            #: Outcome of the run: label, cause, end time; for a live run also the number of missed rows and the
            #: processor time of the recorder.
            self.result: Mapping[str, Any] = values_of(written[RESULT_RECORD])
            self.label, self.cause = RunOutcome(self.result["label"]), str(self.result["cause"])
            #: Number of telemetry rows in the index. In a recovered recording it has only intact rows.
            self.ticks = recording.counts[TELEMETRY_TOPIC]
            self._gaps: tuple[Gap, ...] | None = None

    def blocks(self) -> Iterator[Array]:
        """Yield all intact rows in the recorded order, the rows of one chunk at a time: (n, channels)."""
        for block in self._blocks():
            yield block.rows

    def gaps(self) -> tuple[Gap, ...]:
        """Return the gaps between the rows of `blocks`; reads all rows if `blocks` has not yielded all of them."""
        if self._gaps is None:
            for _ in self._blocks():
                pass
        return self._gaps or ()

    def epoch(self) -> int:
        """Return the wall time at which the rows' time was 0 [ns since 1970]; 0 without rows."""
        (time,) = columns(self.channels, "time")
        return next((block.time - round(1e9 * float(block.rows[0, time])) for block in self._blocks()), 0)

    def events(self) -> tuple[RecordedEvent, ...]:
        """Return all intact events in the order of their time.

        Raises:
            RecordingError: an event is not one of this program.
        """
        found = list[tuple[int, bytes]]()
        with undamaged(self._path):
            topic = self._recording.topic(EVENTS_TOPIC)
            for content in filter(None, chunks_with(self._recording.file, self._recording.summary, topic)):
                found += [(message.time, message.data(content)) for message in messages(content, topic)]
            found.sort(key=lambda event: event[0])
            return tuple(event_of(json.loads(data)) for _, data in found)

    def _blocks(self) -> "Iterator[_Block]":
        topic, (time,) = self._recording.topic(TELEMETRY_TOPIC), columns(self.channels, "time")
        gaps, expected, after = list[Gap](), 0, None
        for content in filter(None, chunks_with(self._recording.file, self._recording.summary, topic)):
            with undamaged(self._path):
                listed = list(messages(content, topic))
                rows = self._format.unpack(b"".join(message.data(content) for message in listed))
                block = _Block(listed[0].time, rows)
            if (missing := listed[0].sequence - expected) > 0:
                gaps.append(Gap(missing, after, float(rows[0, time])))
            expected, after = listed[-1].sequence + 1, float(rows[-1, time])
            yield block
        if self.ticks > expected:
            gaps.append(Gap(self.ticks - expected, after, None))
        self._gaps = tuple(gaps)


class _Block(NamedTuple):
    """Rows of one chunk."""

    time: int  #: wall time of its first row [ns since 1970]
    rows: Array


def missing_rows(gaps: Sequence[Gap]) -> str:
    """Return a text with number and times of the rows in gaps; empty if there is no gap."""
    if not gaps:
        return ""
    more = [f"and {len(gaps) - MAX_NAMED_GAPS} more gaps"] if len(gaps) > MAX_NAMED_GAPS else []
    named = ", ".join([*map(_between, gaps[:MAX_NAMED_GAPS]), *more])
    return f"{sum(gap.rows for gap in gaps)} rows are damaged and missing: {named}"


def _between(gap: Gap) -> str:
    if gap.after is None:
        return "all" if gap.before is None else f"before {gap.before:.3f} s"
    return f"after {gap.after:.3f} s" if gap.before is None else f"{gap.after:.3f} to {gap.before:.3f} s"


class IndexedFile(NamedTuple):
    """Recording with an intact index."""

    file: IO[bytes]  #: the recording, or a complete copy
    summary: Summary
    counts: Mapping[str, int]  #: number of messages by topic
    metadata: Mapping[str, Mapping[str, str]]  #: metadata records by name

    def topic(self, name: str) -> int:
        """Return the number of a topic; raise KeyError if the recording does not have it."""
        return {topic.topic: number for number, topic in self.summary.channels.items()}[name]


@contextmanager
def indexed(file: IO[bytes]) -> Iterator[IndexedFile]:
    """Provide a recording with its index; if the end of the file is damaged, a complete copy in a temporary file.

    Raises:
        OSError, or one of `chunks.DAMAGE`: the file is not a recording of this program, or a copy cannot be written.
    """
    with ExitStack() as opened:
        try:
            found = _indexed(file)
        except DAMAGE:
            if not is_recording(file):
                raise
            copy = opened.enter_context(tempfile.TemporaryFile())
            salvage(file, copy, texts({"label": RunOutcome.INTERRUPTED, "cause": END_DAMAGED}))
            found = _indexed(copy)
        yield found


def _indexed(file: IO[bytes]) -> IndexedFile:
    if not ends_intact(file):
        raise ValueError("the end of the file is damaged or missing")
    file.seek(0)
    reader = make_reader(file)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise ValueError("the index is missing")
    counts = summary.statistics.channel_message_counts
    by_topic = {topic.topic: counts.get(number, 0) for number, topic in summary.channels.items()}
    metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    if not is_outcome(metadata.get(RESULT_RECORD, {})):
        raise ValueError("the outcome is damaged or missing")
    return IndexedFile(file, summary, by_topic, metadata)


@contextmanager
def open_case(path: Path) -> Iterator[CaseReader]:
    """Open a recording for reading block by block.

    Raises:
        RecordingError: the file does not exist, is no regular file or recording, was never finished, or is damaged
            before its first row.
    """
    try:
        file = open_in(path.parent, path.name)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    with ExitStack() as opened:
        opened.enter_context(file)
        if path.name.endswith((PARTIAL_SUFFIX, FULL_SUFFIX)):
            raise RecordingError(f"{path}: not a finished recording; the next start of the station recovers it")
        with undamaged(path):
            recording = opened.enter_context(indexed(file))
        yield CaseReader(path, recording)


@contextmanager
def undamaged(path: Path) -> Iterator[None]:
    """Raise RecordingError instead of the exceptions of reading a damaged file in the block."""
    try:
        yield
    except (*DAMAGE, OSError) as error:
        raise RecordingError(f"{path}: not a recording of this program, or damaged: {error!r}") from None


def read_case(path: Path, max_rows: int | None = None, groups: Container[str] | None = None) -> CaseRecording:
    """Return a whole recording in memory.

    Args:
        path: file of the recording.
        max_rows: largest number of rows; of a longer recording only every n-th row is returned.
        groups: groups of channels to return; None: all channels.

    Raises:
        RecordingError: as `open_case`.
    """
    with open_case(path) as case:
        stride = 1 if max_rows is None else max(1, -(-case.ticks // max_rows))
        names = [channel.name.rsplit(".", 1)[0] for channel in case.channels]
        kept = [at for at, name in enumerate(names) if groups is None or name in groups]
        channels = tuple(case.channels[at] for at in kept)
        rows = np.empty((-(-case.ticks // stride), len(kept)))
        passed, filled = 0, 0
        for block in case.blocks():
            some = block[-passed % stride :: stride]
            rows[filled : filled + len(some)] = some if groups is None else some[:, kept]
            passed, filled = passed + len(block), filled + len(some)
        return CaseRecording(
            channels,
            rows[:filled],
            case.events(),
            case.metadata,
            case.label,
            case.cause,
            stride,
            case.epoch(),
            case.gaps(),
        )


def columns(channels: tuple[Channel, ...], group: str) -> list[int]:
    """Return the column indices of a group's channels.

    Raises:
        RecordingError: the recording has no channels of this group.
    """
    found = [at for at, channel in enumerate(channels) if group in (channel.name, channel.name.rpartition(".")[0])]
    if not found:
        raise RecordingError(f"the recording has no channels '{group}'")
    return found
