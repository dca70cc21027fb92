"""Reading recordings: the whole case at once, or block by block for what does not fit into memory."""

import json
import struct
from collections.abc import Iterator, Mapping
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
from station.recording.events import TOPIC as EVENTS
from station.recording.events import Event, event_of
from station.recording.label import Label, RecordingError
from station.recording.metadata import CHANNELS, RUN, channels_of, is_later, values_of
from station.recording.row_message import PREFIX, TOPIC
from station.recording.summary import HEAD, RESULT


class CaseRecording(NamedTuple):
    """One case as it was recorded."""

    channels: tuple[Channel, ...]
    rows: Array  #: (ticks, channels)
    events: tuple[Event, ...]
    metadata: Mapping[str, Any]  #: configuration, versions, seed, start: what the writer was told
    label: Label
    cause: str  #: why it is not complete

    def of(self, group: str) -> Array:
        """The columns of a group, e.g. `tip_measured`: (ticks, 3).

        Raises:
            RecordingError: it has no such channels.
        """
        return self.rows[:, columns(self.channels, group)]


class CaseReader:
    """An open recording; its rows are read as they are asked for."""

    def __init__(self, path: Path, file: IO[bytes]) -> None:
        """Read what is not rows.

        Raises:
            RecordingError: damaged, never finished, of a later format, or not a recording of this program.
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
            self.metadata: Mapping[str, Any] = values_of(written[RUN])
            if later := is_later(self.metadata):
                raise RecordingError(f"{path}: {later}")
            self.channels = channels_of(written[CHANNELS])
            #: How it ended: label, cause, wall time; of a live one also rows missed and what the recorder took.
            self.result: Mapping[str, Any] = values_of(written[RESULT])
            self.label, self.cause = Label(self.result["label"]), str(self.result["cause"])
            #: Rows in the file.
            self.ticks = summary.statistics.channel_message_counts.get(self._topics[TOPIC], 0)

    def blocks(self) -> Iterator[Array]:
        """All rows in the order they were recorded, a chunk at a time: (n, channels).

        Raises:
            RecordingError: a chunk is damaged.
        """
        topic = self._topics[TOPIC]
        for index in sorted(self._summary.chunk_indexes, key=lambda index: index.chunk_start_offset):
            if topic not in index.message_index_offsets:
                continue  # pictures or events only
            with _undamaged(self._path):
                self._file.seek(index.chunk_start_offset + HEAD)
                stream, length = get_chunk_data_stream(Chunk.read(ReadDataStream(self._file)), validate_crc=True)
                rows = _rows(stream.read(length), topic, len(self.channels))
            yield rows

    def events(self) -> tuple[Event, ...]:
        """Everything that happened, in time.

        Raises:
            RecordingError: a chunk is damaged.
        """
        with _undamaged(self._path):
            found = self._reader.iter_messages(topics=EVENTS)
            return tuple(event_of(json.loads(message.data)) for _, _, message in found)


@contextmanager
def open_case(path: Path) -> Iterator[CaseReader]:
    """A recording to be read block by block.

    Raises:
        RecordingError: there is none, it is damaged, or it was never finished.
    """
    try:
        file = path.open("rb")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    with file:
        yield CaseReader(path, file)


@contextmanager
def _undamaged(path: Path) -> Iterator[None]:
    try:
        yield
    # What a damaged file makes of the library's arithmetic is in nobody's documentation.
    except (McapError, ZstdError, OSError, ValueError, KeyError, IndexError, struct.error) as error:
        raise RecordingError(f"{path}: not a recording of this program, or damaged: {error!r}") from None


def read_case(path: Path, most: int | None = None) -> CaseRecording:
    """All of a recording in memory.

    Args:
        path: the file.
        most: rows; of a longer recording every second, third, ... one is read, as few as are not too many.

    Raises:
        RecordingError: there is none, it is damaged, or it was never finished.
    """
    with open_case(path) as case:
        stride = 1 if most is None else max(1, -(-case.ticks // most))
        rows = np.empty((-(-case.ticks // stride), len(case.channels)))
        passed, filled = 0, 0
        for block in case.blocks():
            some = block[-passed % stride :: stride]
            rows[filled : filled + len(some)] = some
            passed, filled = passed + len(block), filled + len(some)
        return CaseRecording(case.channels, rows, case.events(), case.metadata, case.label, case.cause)


def columns(channels: tuple[Channel, ...], group: str) -> list[int]:
    """Places of a group's channels.

    Raises:
        RecordingError: there are none.
    """
    found = [at for at, channel in enumerate(channels) if group in (channel.name, channel.name.rpartition(".")[0])]
    if not found:
        raise RecordingError(f"the recording has no channels '{group}'")
    return found


def _rows(content: bytes, topic: int, width: int) -> Array:
    """Rows in a chunk's content: (n, width)."""
    size = 8 * width
    rows: list[Array] = []
    place = 0
    while place < len(content):
        length = int.from_bytes(content[place + 1 : place + HEAD], "little")
        if content[place] == Opcode.MESSAGE and content[place + HEAD] + 256 * content[place + HEAD + 1] == topic:
            rows.append(np.frombuffer(content, "<f8", width, place + PREFIX))
            if length != PREFIX - HEAD + size:
                raise ValueError(f"a row of {length - PREFIX + HEAD} bytes instead of {size}")
        place += HEAD + length
    return np.array(rows) if rows else np.empty((0, width))
