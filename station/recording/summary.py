"""The end of an MCAP file: cut what is not whole, say how it ended, write the index.

The same way for a recording that ends well and for one that was left behind, so that recovery is the
ordinary close. It may be killed at any point and begun again: the chunks are never touched.
"""

import fcntl
import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import (
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Metadata,
    MetadataIndex,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import CRCValidationError, get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

from station.recording.data_section import index_record
from station.recording.label import RecordingError

#: Name of the metadata record that says how the recording ended.
RESULT = "result"
#: Bytes before a record's content: opcode and length.
HEAD = 9
#: Bytes of a chunk before its messages, apart from the name of the compression.
CHUNK_HEAD = 40
LONGEST_NAME = 16


@dataclass
class _Contents:
    """What a walk along the file has found."""

    end: int = len(MCAP0_MAGIC)  #: of what is whole
    schemas: bytearray = field(default_factory=bytearray)
    topics: bytearray = field(default_factory=bytearray)
    chunks: bytearray = field(default_factory=bytearray)
    metadata: bytearray = field(default_factory=bytearray)
    counts: dict[int, int] = field(default_factory=dict)  #: messages by topic
    schema_count: int = 0
    chunk_count: int = 0
    metadata_count: int = 0
    times: tuple[int, int] | None = None  #: of the first and the last message [ns]
    repair: bytearray = field(default_factory=bytearray)  #: message indexes that the last chunk lacks
    result: Mapping[str, str] | None = None  #: of an earlier end that was not finished


def finish_file(path: Path, result: Mapping[str, str], *, verify: bool) -> Mapping[str, str]:
    """Make a whole MCAP file of one that ends anywhere.

    Args:
        path: the file, not being written by anybody.
        result: how it ended; an end that was begun earlier stands.
        verify: look into every chunk, because the file was left behind.

    Returns:
        The result that stands in the file.

    Raises:
        RecordingError: there is no MCAP file in it.
        OSError: it cannot be written; what was whole stays so.
    """
    with path.open("r+b", buffering=0) as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.pread(file.fileno(), len(MCAP0_MAGIC), 0) != MCAP0_MAGIC:
            raise RecordingError(f"{path}: the disk has nothing of this recording, not even its first bytes")
        found = _walk(file.fileno(), verify=verify)
        stands = result if found.result is None else found.result
        file.truncate(found.end)
        file.seek(found.end)
        tail = memoryview(_tail(found, stands))
        while tail:
            tail = tail[file.write(tail) or 0 :]
        os.fsync(file.fileno())
    return stands


def _walk(descriptor: int, *, verify: bool) -> _Contents:
    """From record to record to the last one that is whole."""
    found, size = _Contents(), os.fstat(descriptor).st_size
    while len(head := os.pread(descriptor, HEAD, found.end)) == HEAD:
        opcode, length = struct.unpack("<BQ", head)
        start, end = found.end, found.end + HEAD + length
        if end > size or opcode in (0, Opcode.DATA_END):
            break
        if opcode == Opcode.CHUNK:
            after = _chunk(descriptor, start, end, size, found, verify=verify)
            if after is None:
                break
            found.end = after
            continue
        record = os.pread(descriptor, HEAD + length, start)
        if opcode == Opcode.METADATA:
            metadata = Metadata.read(ReadDataStream(BytesIO(record[HEAD:])))
            if metadata.name == RESULT:
                found.result = metadata.metadata
                break
            _add(found.metadata, MetadataIndex(start, len(record), metadata.name))
            found.metadata_count += 1
        elif opcode == Opcode.SCHEMA:
            found.schemas += record
            found.schema_count += 1
        elif opcode == Opcode.CHANNEL:
            found.topics += record
            found.counts[struct.unpack_from("<H", record, HEAD)[0]] = 0
        found.end = end
    return found


def _chunk(descriptor: int, start: int, end: int, size: int, found: _Contents, *, verify: bool) -> int | None:
    """Note the chunk at `start` and its message indexes; where the next record begins, None if it is not whole."""
    stream = ReadDataStream(BytesIO(os.pread(descriptor, CHUNK_HEAD + LONGEST_NAME, start + HEAD)))
    first, last, uncompressed = stream.read8(), stream.read8(), stream.read8()
    stream.read4()
    compression = str(stream.read(stream.read4()), "ascii")
    content = None
    if verify:
        try:
            content = _content(os.pread(descriptor, end - start - HEAD, start + HEAD))
        except (CRCValidationError, ZstdError, EndOfFile, ValueError):
            return None
    offsets: dict[int, int] = {}
    place = end
    while len(head := os.pread(descriptor, HEAD + 6, place)) == HEAD + 6:
        opcode, length, topic, entries = struct.unpack("<BQHI", head)
        if opcode != Opcode.MESSAGE_INDEX or place + HEAD + length > size:
            break
        offsets[topic] = place
        found.counts[topic] = found.counts.get(topic, 0) + entries // 16
        place += HEAD + length
    if content is not None:
        # A kill may fall between a chunk and its indexes; they follow from the chunk.
        for topic, listed in _entries(content).items():
            if topic not in offsets:
                offsets[topic] = place + len(found.repair)
                found.counts[topic] = found.counts.get(topic, 0) + len(listed) // 16
                found.repair += index_record(topic, listed)
    index = ChunkIndex(
        chunk_length=end - start,
        chunk_start_offset=start,
        compression=compression,
        compressed_size=end - start - HEAD - CHUNK_HEAD - len(compression),
        message_start_time=first,
        message_end_time=last,
        message_index_length=place + len(found.repair) - end,
        message_index_offsets=offsets,
        uncompressed_size=uncompressed,
    )
    _add(found.chunks, index)
    found.chunk_count += 1
    earliest, latest = found.times or (first, last)
    found.times = (min(earliest, first), max(latest, last))
    return place


def _content(record: bytes) -> bytes:
    """The messages of a chunk, decompressed and found undamaged."""
    chunk = Chunk.read(ReadDataStream(BytesIO(record)))
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)


def _entries(content: bytes) -> dict[int, bytes]:
    """Message index entries of a chunk's content by topic."""
    found: dict[int, bytes] = {}
    place = 0
    while place < len(content):
        opcode, length = struct.unpack_from("<BQ", content, place)
        if opcode == Opcode.MESSAGE:
            topic, _sequence, time = struct.unpack_from("<HIQ", content, place + HEAD)
            found[topic] = found.get(topic, b"") + struct.pack("<QQ", time, place)
        place += HEAD + length
    return found


def _tail(found: _Contents, result: Mapping[str, str]) -> bytes:
    """What the last chunk lacks, result, end of the data, summary and footer."""
    tail = RecordBuilder()
    tail.write(found.repair)
    Metadata(RESULT, dict(result)).write(tail)
    place = len(found.repair)
    _add(found.metadata, MetadataIndex(found.end + place, tail.count - place, RESULT))
    DataEnd(0).write(tail)
    start = found.end + tail.count
    first, last = found.times or (0, 0)
    statistics = bytearray()
    _add(
        statistics,
        Statistics(
            attachment_count=0,
            channel_count=len(found.counts),
            channel_message_counts=found.counts,
            chunk_count=found.chunk_count,
            message_count=sum(found.counts.values()),
            message_end_time=last,
            message_start_time=first,
            metadata_count=found.metadata_count + 1,
            schema_count=found.schema_count,
        ),
    )
    summary, offsets = bytearray(), RecordBuilder()
    for opcode, records in (
        (Opcode.SCHEMA, found.schemas),
        (Opcode.CHANNEL, found.topics),
        (Opcode.STATISTICS, statistics),
        (Opcode.CHUNK_INDEX, found.chunks),
        (Opcode.METADATA_INDEX, found.metadata),
    ):
        if records:
            SummaryOffset(opcode, start + len(summary), len(records)).write(offsets)
            summary += records
    offset_start = start + len(summary)
    summary += offsets.end()
    checked = zlib.crc32(summary)
    checked = zlib.crc32(struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, start, offset_start), checked)
    tail.write(summary)
    Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=checked).write(tail)
    tail.write(MCAP0_MAGIC)
    return tail.end()


def _add(records: bytearray, record: ChunkIndex | MetadataIndex | Statistics) -> None:
    builder = RecordBuilder()
    record.write(builder)
    records += builder.end()
