"""Data section of an MCAP file: complete chunks are appended to the file, and none is kept in memory.

This module uses the records of the `mcap` library but not its writer. That writer creates a Python object for every
message, which is too slow for 500 rows a second while a control loop runs. It also keeps an index of all chunks, which
grows during a run of days. `summary.py` creates the index at the end of the file instead.

A telemetry row is a message of consecutive little-endian numbers, float64 or float32. ROS 1 serialises a message of
such fields in the same form, so the schema is a ROS 1 message definition: a field for each channel, a nested message
for each group, and the unit as a comment. No ROS is needed: `numpy.frombuffer(data, RowFormat.dtype)` is the row.
"""

import fcntl
import io
import os
import re
import struct
import sys
import zlib
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel as TopicRecord
from mcap.records import Chunk, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from core.robot.robot import Array
from station.control.telemetry import Channel

TELEMETRY_TOPIC = "/telemetry"
TELEMETRY_SCHEMA = "ctr_station/Telemetry"
#: Length of an MCAP message record before its payload: opcode, length, topic, sequence number and two times [bytes].
MESSAGE_HEADER_BYTES = 31
#: Name of this program in the header of the MCAP file.
LIBRARY = "ctr-station"
#: Name of the compression of chunks.
COMPRESSION = "zstd"
#: Compression level of zstd: level -1 takes a third less time and gives 19 % more bytes, level 3 gives 2 % less.
ZSTD_LEVEL = 1
#: Groups of channels that devices measure. They are recorded in single precision without rounding. It keeps every count
#: (1 uN) of a Net F/T up to 8 N, and an Aurora sends its positions in this precision.
MEASURED_GROUPS = frozenset({"joints", "wrench_raw", "tip_measured", "target_measured", "direction_measured"})
#: Units of computed channels with the multiple to which a recording rounds their values. Each is a power of two, far
#: below the resolution of the devices: an Aurora resolves 0.1 mm, a Nano43 resolves 4 mN and 50 uN m.
RESOLUTIONS = MappingProxyType(
    {
        "m": 2.0**-22,  # 0.24 um
        "rad": 2.0**-22,
        "m/s": 2.0**-18,  # 4 um/s
        "rad/s": 2.0**-18,
        "N": 2.0**-14,  # 61 uN
        "N/s": 2.0**-14,
        "N m": 2.0**-21,  # 0.5 uN m
    }
)
#: Prefix of the groups of unit vectors, which are rounded like angles.
UNIT_VECTORS = "direction_"
#: Significant bits of computed channels whose unit is not above, such as variances; the state, an integer, stays exact.
SIGNIFICANT_BITS = 11
DOUBLE, SINGLE = "float64", "float32"


class Rows(NamedTuple):
    """Consecutive message records, one for each row, with their offsets."""

    times: NDArray[np.uint64]  #: time of each row (n,) [ns]
    records: bytes
    offsets: NDArray[np.uint64]  #: offset of each record from the start of `records` (n,) [bytes]


NO_ROWS = Rows(np.empty(0, np.uint64), b"", np.empty(0, np.uint64))


class RowFormat:
    """Binary form of a telemetry row: one little-endian number for each channel, without padding."""

    def __init__(self, channels: Sequence[Channel], types: Sequence[str] = ()) -> None:
        """`types` has the ROS type of each channel, `float64` or `float32`; empty: all are `float64`."""
        self.channels = channels
        self.types = tuple(types) or (DOUBLE,) * len(channels)
        if len(self.types) != len(channels) or not {DOUBLE, SINGLE}.issuperset(self.types):
            raise ValueError(f"{len(channels)} channels need as many types float64 or float32, not {self.types}")
        self._parts: list[slice] = []  # consecutive columns of the same type
        for _, columns in groupby(range(len(channels)), lambda column: self.types[column]):
            listed = list(columns)
            self._parts.append(slice(listed[0], listed[-1] + 1))
        self.dtype = np.dtype(
            [(f"columns_{part.start}", self.types[part.start], (part.stop - part.start,)) for part in self._parts]
        ).newbyteorder("<")

    @classmethod
    def compact(cls, channels: Sequence[Channel]) -> "RowFormat":
        """Return the format of new recordings: times in double precision, everything else in single precision."""
        return cls(channels, [DOUBLE if channel.unit == "s" else SINGLE for channel in channels])

    @property
    def definition(self) -> str:
        """ROS 1 message definition of a row."""
        main: list[str] = []
        parts: list[str] = []
        fields, kinds = set[str](), set[str]()
        types = iter(self.types)
        for group, members in _grouped(self.channels):
            if members[0][0] == "":
                main.append(f"{next(types)} {_identifier(group, fields)}{_comment(members[0][1])}")
                continue
            kind = unique_name("".join(word.capitalize() for word in _identifier(group, set()).split("_")), kinds)
            main.append(f"{kind} {_identifier(group, fields)}")
            inner = set[str]()
            parts.append(f"{'=' * 80}\nMSG: ctr_station/{kind}")
            parts += [f"{next(types)} {_identifier(name, inner)}{_comment(channel)}" for name, channel in members]
        return "\n".join((*main, *parts)) + "\n"

    def pack(self, rows: Array) -> NDArray[np.void]:
        """Return rows (n, channels) in this format: (n,) of `dtype`."""
        packed = np.empty(len(rows), self.dtype)
        for part in self._parts:
            packed[f"columns_{part.start}"] = rows[:, part]
        return packed

    def unpack(self, data: bytes) -> Array:
        """Return the rows (n, channels) of consecutive packed rows.

        Raises:
            ValueError: the data are not a whole number of rows.
        """
        packed = np.frombuffer(data, self.dtype)
        rows = np.empty((len(packed), len(self.channels)))
        for part in self._parts:
            rows[:, part] = packed[f"columns_{part.start}"]
        return rows


class Rounding:
    """Rounding of the computed channels of a recording, so that the file becomes smaller when compressed."""

    def __init__(self, channels: Sequence[Channel]) -> None:
        computed = [
            (column, _resolution(channel))
            for column, channel in enumerate(channels)
            if channel.unit != "s" and channel.name.rpartition(".")[0] not in MEASURED_GROUPS
        ]
        self._fixed = np.array([column for column, resolution in computed if resolution], np.intp)
        self._resolution = np.array([resolution for _, resolution in computed if resolution])
        self._floating = np.array([column for column, resolution in computed if not resolution], np.intp)

    def rounded(self, rows: Array) -> Array:
        """Return a copy of rows (n, channels), rounded to multiples of `RESOLUTIONS` or to `SIGNIFICANT_BITS`."""
        rows = rows.copy()
        rows[:, self._fixed] = np.rint(rows[:, self._fixed] / self._resolution) * self._resolution
        mantissas, exponents = np.frexp(rows[:, self._floating])
        scale = 2.0**SIGNIFICANT_BITS
        rows[:, self._floating] = np.ldexp(np.rint(mantissas * scale) / scale, exponents)
        return rows


def _resolution(channel: Channel) -> float | None:
    """Return the multiple to which a computed channel is rounded, or None for `SIGNIFICANT_BITS`."""
    return RESOLUTIONS["rad"] if channel.name.startswith(UNIT_VECTORS) else RESOLUTIONS.get(channel.unit)


def message_records(rows: NDArray[np.void], times: NDArray[np.uint64], topic: int, first: int) -> Rows:
    """Return the MCAP message records of telemetry rows.

    Args:
        rows: rows (n,) packed by `RowFormat.pack`.
        times: time of each row (n,) [ns].
        topic: MCAP channel id.
        first: sequence number of the first row.
    """
    count = len(rows)
    records = np.empty(count, _record(rows.dtype))
    records["opcode"], records["length"] = Opcode.MESSAGE, records.itemsize - 9
    records["topic"] = topic
    records["sequence"] = np.arange(first, first + count, dtype=np.uint64)
    records["log_time"] = records["publish_time"] = times
    records["row"] = rows
    return Rows(times, records.tobytes(), np.arange(count, dtype=np.uint64) * np.uint64(records.itemsize))


def _record(row: np.dtype[np.void]) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("topic", "<u2"),
            ("sequence", "<u4"),
            ("log_time", "<u8"),
            ("publish_time", "<u8"),
            ("row", row),
        ]
    )


def _grouped(channels: Sequence[Channel]) -> Iterator[tuple[str, list[tuple[str, Channel]]]]:
    """Yield the name of each channel group with its members.

    A channel without a group is a group with a single member, whose name is empty.
    """

    def group(channel: Channel) -> str:
        return channel.name.rpartition(".")[0] or channel.name

    for name, members in groupby(channels, group):
        listed = list(members)
        alone = listed[0].name == name
        yield name, [("" if alone else channel.name.rpartition(".")[2], channel) for channel in listed]


def _comment(channel: Channel) -> str:
    return f"  # [{channel.unit}]" if channel.unit else ""


def _identifier(name: str, taken: set[str]) -> str:
    """Return the name as a valid name of a ROS field that is not in `taken`, and add it there."""
    return unique_name(re.sub(r"\W", "_", name, flags=re.ASCII), taken)


def unique_name(plain: str, taken: set[str], longest: int = sys.maxsize) -> str:
    """Return a name that starts with a letter, has at most `longest` characters and is not in `taken`; add it there.

    `plain` has only letters, digits and underscores.
    """
    name = base = (plain if plain[:1].isalpha() else f"c_{plain}")[:longest]
    number = 2
    while name in taken:
        ending = f"_{number}"
        name, number = base[: longest - len(ending)] + ending, number + 1
    taken.add(name)
    return name


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
        self.file = path.open("x+b", buffering=0)  #: the open file; locked until `close`
        try:
            fcntl.flock(self.file, fcntl.LOCK_EX)  # only a recovery may have locked the new file, for a moment
            self._end = 0  # offset after the last complete record
            self._compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL)
            head = RecordBuilder()
            head.write(first_bytes())
            for name, entries in metadata.items():
                Metadata(name, dict(entries)).write(head)
            for number, topic in enumerate(topics, start=1):
                Schema(number, topic.definition.encode(), topic.schema_encoding, topic.schema).write(head)
                TopicRecord(number, topic.name, topic.encoding, {}, number).write(head)
            self._append(head.end())
        except BaseException:
            self.file.close()
            raise

    def write_chunk(self, rows: Rows, topic: int, messages: Sequence[WrittenMessage]) -> None:
        """Append a chunk with rows of one topic and messages of other topics, and give it to the operating system.

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
            compression=COMPRESSION,
            data=self._compressor.compress(content),
            message_start_time=min(times),
            message_end_time=max(times),
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        ).write(group)
        for number, entries in index.items():
            group.write(index_record(number, entries))
        self._append(group.end())

    def cut(self) -> None:
        """Cut the file after the last complete chunk."""
        self.file.truncate(self._end)

    def close(self) -> None:
        """Close and unlock the file."""
        self.file.close()

    def _append(self, data: bytes) -> None:
        left = memoryview(data)
        while left:
            # On a nearly full disk, only a part of the data is written. The next attempt then raises the error.
            left = left[self.file.write(left) or 0 :]
        self._end += len(data)


def first_bytes() -> bytes:
    """Return the bytes with which every recording of this program starts."""
    head = RecordBuilder()
    head.write(MCAP0_MAGIC)
    Header("", LIBRARY).write(head)
    return head.end()


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
    """Flush a folder's list of file names to the disk, so that new names survive a power failure."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
