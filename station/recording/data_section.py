"""Data section of an MCAP file: complete chunks are appended to the file, and none is kept in memory.

This module uses the records of the `mcap` library but not its writer. That writer creates a Python object for every
message, which is too slow for 500 rows a second while a control loop runs. It also keeps an index of all chunks, which
grows during a run of days. `summary.py` creates the index at the end of the file instead.
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

from station.recording.row_message import MESSAGE_HEADER_BYTES, Rows

#: Name of this program in the header of the MCAP file.
LIBRARY = "ctr-station"
#: Compression level of zstd: it takes a third less time than level 1 and gives 4 % more bytes.
ZSTD_LEVEL = -1


class Topic(NamedTuple):
    """Stream of MCAP messages of one kind; the id of a topic is its position in the file's list, counted from 1."""

    name: str
    encoding: str  #: encoding of the messages: ros1 or json
    schema: str
    schema_encoding: str  #: ros1msg or jsonschema
    definition: str


class WrittenMessage(NamedTuple):
    """MCAP message that is not a telemetry row: an event or a drawing."""

    topic: int
    time: int  #: time of the message [ns]
    data: bytes


class DataSection:
    """MCAP file that is being written; it is locked, so that a recovery does not treat its writer as killed."""

    def __init__(self, path: Path, metadata: Mapping[str, Mapping[str, str]], topics: Sequence[Topic]) -> None:
        """Create the MCAP file and write the records that precede the messages: header, metadata and topics.

        Raises:
            OSError: the file cannot be created or written.
        """
        self.path = path
        self._file = path.open("xb", buffering=0)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._end = 0  # offset after the last complete record
            self._compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
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

    def write_chunk(self, rows: Rows, topic: int, messages: Sequence[WrittenMessage]) -> None:
        """Append a chunk with rows of one topic and messages of others, and give it to the operating system.

        Raises:
            OSError: the chunk cannot be written; the file then ends with the previous chunk.
        """
        body, index = io.BytesIO(), {}
        body.write(rows.records)
        if len(rows.times):
            entries_of_rows = np.empty((len(rows.times), 2), "<u8")
            entries_of_rows[:, 0], entries_of_rows[:, 1] = rows.times, rows.offsets
            index[topic] = entries_of_rows.tobytes()
        for message in messages:
            entry = struct.pack("<QQ", message.time, body.tell())
            index[message.topic] = index.get(message.topic, b"") + entry
            body.write(message_record(message))
        if not index:
            return
        times = [*rows.times[:1].tolist(), *rows.times[-1:].tolist(), *(message.time for message in messages)]
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
        """Cut the file after the last complete chunk, and close it."""
        with self._file:
            self._file.truncate(self._end)

    def _append(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            # A nearly full disk writes only a part of the data. The next attempt to write then raises the error.
            left = left[self._file.write(left) or 0 :]
        self._end += len(data)


def message_record(message: WrittenMessage) -> bytes:
    """Return an MCAP message as the record that a chunk contains."""
    head = struct.pack(
        "<BQHIQQ",
        Opcode.MESSAGE,
        MESSAGE_HEADER_BYTES - 9 + len(message.data),
        message.topic,
        0,
        message.time,
        message.time,
    )
    return head + message.data


def index_record(topic: int, entries: bytes) -> bytes:
    """Return the index record of a topic's messages in the chunk before it; `entries` are pairs of time and offset."""
    return struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(entries), topic, len(entries)) + entries


def sync_folder(folder: Path) -> None:
    """Flush a folder's list of file names to the disk, so that new names survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
