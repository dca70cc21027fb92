"""The growing part of an MCAP file: whole chunks, one after the other, nothing kept in memory.

The `mcap` library knows the records; its writer is not used, because it makes a Python object of every
message and keeps an index entry of every chunk until the end: too slow for 500 rows a second beside a
control loop, and too large after a day. `summary.py` makes the index when the file ends.
"""

import fcntl
import io
import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from station.recording.row_message import PREFIX, Rows

#: What the header says wrote the file.
LIBRARY = "ctr-station"
#: Of zstd: a third less time than level 1 for four hundredths more bytes.
LEVEL = -1


class Topic(NamedTuple):
    """A stream of messages of one kind; its id is its place in the file's list, from 1."""

    name: str
    encoding: str  #: of the messages: ros1 or json
    schema: str
    schema_encoding: str  #: ros1msg or jsonschema
    definition: str


class Said(NamedTuple):
    """A message that is not a row."""

    topic: int
    time: int  #: [ns]
    data: bytes


class DataSection:
    """An MCAP file that is being written; locked, so that nobody takes it for one that was left behind."""

    def __init__(self, path: Path, metadata: Mapping[str, Mapping[str, str]], topics: Sequence[Topic]) -> None:
        """Make the file and write what comes before the messages.

        Raises:
            OSError: it cannot be made or written.
        """
        self.path = path
        self._file = path.open("xb", buffering=0)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._end = 0  # what lies beyond is not whole
            self._compressor = zstandard.ZstdCompressor(level=LEVEL)
            head = RecordBuilder()
            head.write(MCAP0_MAGIC)
            Header("", LIBRARY).write(head)
            for name, entries in metadata.items():
                Metadata(name, dict(entries)).write(head)
            for number, topic in enumerate(topics, start=1):
                Schema(number, topic.definition.encode(), topic.schema_encoding, topic.schema).write(head)
                Channel(number, topic.name, topic.encoding, {}, number).write(head)
            self._append(head.end())
        except BaseException:
            self._file.close()
            raise

    def write_chunk(self, rows: Rows, topic: int, said: Sequence[Said]) -> None:
        """Add a chunk with rows of one topic and messages of others, and hand it to the operating system.

        Raises:
            OSError: the disk does not take it; the file ends with the chunk before.
        """
        body, index = io.BytesIO(), {}
        body.write(rows.records)
        if len(rows.times):
            places = np.empty((len(rows.times), 2), "<u8")
            places[:, 0], places[:, 1] = rows.times, rows.offsets
            index[topic] = places.tobytes()
        for message in said:
            entry = struct.pack("<QQ", message.time, body.tell())
            index[message.topic] = index.get(message.topic, b"") + entry
            body.write(message_record(message))
        if not index:
            return
        times = [*rows.times[:1].tolist(), *rows.times[-1:].tolist(), *(message.time for message in said)]
        content = body.getvalue()
        group = RecordBuilder()
        Chunk(
            compression="zstd",
            data=self._compressor.compress(content),
            message_start_time=min(times),
            message_end_time=max(times),
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        ).write(group)
        for number, entries in index.items():
            group.write(index_record(number, entries))
        self._append(group.end())

    def close(self) -> None:
        """Let go of the file, cut after the last whole chunk."""
        with self._file:
            self._file.truncate(self._end)

    def _append(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            # A full disk takes a part first and says so at the next attempt.
            left = left[self._file.write(left) or 0 :]
        self._end += len(data)


def message_record(message: Said) -> bytes:
    """One message as it stands in a chunk."""
    head = struct.pack(
        "<BQHIQQ", Opcode.MESSAGE, PREFIX - 9 + len(message.data), message.topic, 0, message.time, message.time
    )
    return head + message.data


def index_record(topic: int, entries: bytes) -> bytes:
    """Where the messages of a topic are in the chunk before: pairs of time and offset."""
    return struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(entries), topic, len(entries)) + entries


def sync_folder(folder: Path) -> None:
    """Make names in a folder outlive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
