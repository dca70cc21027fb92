"""Reading of recordings: a whole case at once, or block by block if the case is larger than the memory."""

import json
import struct
from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary
from zstandard import ZstdError

from core.robot.robot import Array
from station.control.telemetry import Channel
from station.recording.data_section import MESSAGE_HEADER_BYTES, TELEMETRY_TOPIC, RowFormat
from station.recording.foxglove import EVENTS_TOPIC, RecordedEvent, event_of
from station.recording.metadata import CHANNELS_RECORD, RUN_RECORD, is_later, row_format, values_of
from station.recording.run_outcome import RecordingError, RunOutcome
from station.recording.summary import RECORD_HEADER_BYTES, RESULT_RECORD
from station.regular_file import open_in

#: Largest number of rows from which the errors of a run are computed: every tick of half an hour. Of a longer run only
#: every n-th row is used.
MAX_SUMMARY_ROWS = 1_000_000


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

    def of(self, group: str) -> Array:
        """Return the columns of a channel group; `tip_measured` has (ticks, 3).

        Raises:
            RecordingError: the recording has no such channels.
        """
        return self.rows[:, columns(self.channels, group)]


class CaseReader:
    """Recording that is open for reading; its rows are read on demand."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        """Read everything in the recording except the rows.

        Raises:
            RecordingError: the file is damaged, unfinished, of a later format, or not a recording of this program.
        """
        self._path, self._file = path, file
        with _undamaged(path):
            self._reader = make_reader(file, validate_crcs=True)
            summary = self._reader.get_summary()
            if summary is None or summary.statistics is None:
                raise RecordingError(f"{path}: not a finished recording; the next start of the station recovers it")
            self._summary: Summary = summary
            self._topics = {topic.topic: number for number, topic in summary.channels.items()}
            written = {record.name: record.metadata for record in self._reader.iter_metadata()}
            self.metadata: Mapping[str, Any] = values_of(written[RUN_RECORD])
            if later := is_later(self.metadata):
                raise RecordingError(f"{path}: {later}")
            self._format = row_format(written[CHANNELS_RECORD])
            self.channels = tuple(self._format.channels)
            #: Outcome of the run: label, cause, end time; for a live run also the number of missed rows and the
            #: processor time of the recorder.
            self.result: Mapping[str, Any] = values_of(written[RESULT_RECORD])
            self.label, self.cause = RunOutcome(self.result["label"]), str(self.result["cause"])
            #: Number of telemetry rows in the recording.
            self.ticks = summary.statistics.channel_message_counts.get(self._topics[TELEMETRY_TOPIC], 0)

    def blocks(self) -> Iterator[Array]:
        """Yield all rows in the recorded order, the rows of one chunk at a time: (n, channels).

        Raises:
            RecordingError: a chunk is damaged.
        """
        topic = self._topics[TELEMETRY_TOPIC]
        for index in sorted(self._summary.chunk_indexes, key=lambda index: index.chunk_start_offset):
            if topic not in index.message_index_offsets:
                continue  # this chunk has only drawings or events
            with _undamaged(self._path):
                self._file.seek(index.chunk_start_offset + RECORD_HEADER_BYTES)
                stream, length = get_chunk_data_stream(Chunk.read(ReadDataStream(self._file)), validate_crc=True)
                rows = _rows(stream.read(length), topic, self._format)
            yield rows

    def epoch(self) -> int:
        """Return the wall time at which the rows' time was 0 [ns since 1970]; 0 without rows.

        Raises:
            RecordingError: a chunk is damaged.
        """
        if self.ticks == 0:
            return 0
        first = next(self.blocks())[0, columns(self.channels, "time")[0]]
        with _undamaged(self._path):
            _, _, message = next(iter(self._reader.iter_messages(topics=TELEMETRY_TOPIC)))
        return message.log_time - round(1e9 * float(first))

    def events(self) -> tuple[RecordedEvent, ...]:
        """Return all events in the order of their time.

        Raises:
            RecordingError: a chunk is damaged.
        """
        with _undamaged(self._path):
            found = self._reader.iter_messages(topics=EVENTS_TOPIC)
            return tuple(event_of(json.loads(message.data)) for _, _, message in found)


@contextmanager
def open_case(path: Path) -> Iterator[CaseReader]:
    """Open a recording for reading block by block.

    Raises:
        RecordingError: the file does not exist, is no regular file, is damaged, or was never finished.
    """
    try:
        file = open_in(path.parent, path.name)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    with file:
        yield CaseReader(path, file)


@contextmanager
def _undamaged(path: Path) -> Iterator[None]:
    try:
        yield
    # The mcap library does not document which exceptions a damaged file causes, so several types are caught.
    except (McapError, ZstdError, OSError, ValueError, KeyError, IndexError, struct.error) as error:
        raise RecordingError(f"{path}: not a recording of this program, or damaged: {error!r}") from None


def read_case(path: Path, max_rows: int | None = None, groups: Container[str] | None = None) -> CaseRecording:
    """Return a whole recording in memory.

    Args:
        path: file of the recording.
        max_rows: largest number of rows; of a longer recording only every n-th row is returned.
        groups: groups of channels to return; None: all channels.

    Raises:
        RecordingError: the file does not exist, is damaged, or was never finished.
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
        return CaseRecording(channels, rows, case.events(), case.metadata, case.label, case.cause, stride, case.epoch())


def columns(channels: tuple[Channel, ...], group: str) -> list[int]:
    """Return the column indices of a group's channels.

    Raises:
        RecordingError: the recording has no channels of this group.
    """
    found = [at for at, channel in enumerate(channels) if group in (channel.name, channel.name.rpartition(".")[0])]
    if not found:
        raise RecordingError(f"the recording has no channels '{group}'")
    return found


def _rows(content: bytes, topic: int, rows: RowFormat) -> Array:
    """Return the telemetry rows (n, channels) in the decompressed content of a chunk."""
    found: list[bytes] = []
    offset = 0
    while offset < len(content):
        length = int.from_bytes(content[offset + 1 : offset + RECORD_HEADER_BYTES], "little")
        end = offset + RECORD_HEADER_BYTES + length
        if (
            content[offset] == Opcode.MESSAGE
            and content[offset + RECORD_HEADER_BYTES] + 256 * content[offset + RECORD_HEADER_BYTES + 1] == topic
        ):
            found.append(content[offset + MESSAGE_HEADER_BYTES : end])
            if len(found[-1]) != rows.dtype.itemsize:
                raise ValueError(f"a row of {len(found[-1])} bytes instead of {rows.dtype.itemsize}")
        offset = end
    return rows.unpack(b"".join(found))
