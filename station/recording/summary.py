"""End of an MCAP file: cut incomplete records, then write the outcome and the index.

A regular end and a recovery after a kill use the same code. This code may be killed at any point and can then be
repeated, because it never changes a chunk.
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
from station.recording.run_outcome import RecordingError

#: Name of the metadata record with the outcome of the recording.
RESULT_RECORD = "result"
#: Length of the header of an MCAP record: opcode and length of the content [bytes].
RECORD_HEADER_BYTES = 9
#: Length of a chunk's header before its messages, without the name of the compression [bytes].
CHUNK_HEADER_BYTES = 40
MAX_COMPRESSION_NAME = 16


@dataclass
class _Contents:
    """Contents of an MCAP file up to its last complete record, as the index needs them."""

    end: int = len(MCAP0_MAGIC)  #: offset after the last complete record [bytes]
    schemas: bytearray = field(default_factory=bytearray)
    topics: bytearray = field(default_factory=bytearray)
    chunks: bytearray = field(default_factory=bytearray)
    metadata: bytearray = field(default_factory=bytearray)
    counts: dict[int, int] = field(default_factory=dict)  #: number of messages by topic
    schema_count: int = 0
    chunk_count: int = 0
    metadata_count: int = 0
    times: tuple[int, int] | None = None  #: times of the first and the last message [ns]
    repair: bytearray = field(default_factory=bytearray)  #: message indexes that are missing after the last chunk
    result: Mapping[str, str] | None = None  #: outcome that an earlier, interrupted call has written


def finish_file(path: Path, result: Mapping[str, str], *, verify: bool) -> Mapping[str, str]:
    """Complete an MCAP file that may end anywhere.

    Args:
        path: file to complete; no process may be writing it.
        result: outcome of the recording; an outcome that an earlier, interrupted call has written takes precedence.
        verify: whether to check every chunk, which is necessary if the writer was killed.

    Returns:
        The outcome that is in the file.

    Raises:
        RecordingError: the file is not an MCAP file.
        OSError: the file cannot be written; its complete records stay unchanged.
    """
    with path.open("r+b", buffering=0) as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.pread(file.fileno(), len(MCAP0_MAGIC), 0) != MCAP0_MAGIC:
            raise RecordingError(f"{path}: not a recording, because the file does not start as an MCAP file")
        found = _walk(file.fileno(), verify=verify)
        kept = result if found.result is None else found.result
        file.truncate(found.end)
        file.seek(found.end)
        tail = memoryview(_tail(found, kept))
        while tail:
            tail = tail[file.write(tail) or 0 :]
        os.fsync(file.fileno())
    return kept


def _walk(descriptor: int, *, verify: bool) -> _Contents:
    """Read the records of a file up to the last complete one and return the contents for the index."""
    found, size = _Contents(), os.fstat(descriptor).st_size
    while len(head := os.pread(descriptor, RECORD_HEADER_BYTES, found.end)) == RECORD_HEADER_BYTES:
        opcode, length = struct.unpack("<BQ", head)
        start, end = found.end, found.end + RECORD_HEADER_BYTES + length
        if end > size or opcode in (0, Opcode.DATA_END):
            break
        if opcode == Opcode.CHUNK:
            after = _chunk(descriptor, start, end, size, found, verify=verify)
            if after is None:
                break
            found.end = after
            continue
        record = os.pread(descriptor, RECORD_HEADER_BYTES + length, start)
        if opcode == Opcode.METADATA:
            metadata = Metadata.read(ReadDataStream(BytesIO(record[RECORD_HEADER_BYTES:])))
            if metadata.name == RESULT_RECORD:
                found.result = metadata.metadata
                break
            _add(found.metadata, MetadataIndex(start, len(record), metadata.name))
            found.metadata_count += 1
        elif opcode == Opcode.SCHEMA:
            found.schemas += record
            found.schema_count += 1
        elif opcode == Opcode.CHANNEL:
            found.topics += record
            found.counts[struct.unpack_from("<H", record, RECORD_HEADER_BYTES)[0]] = 0
        found.end = end
    return found


def _chunk(descriptor: int, start: int, end: int, size: int, found: _Contents, *, verify: bool) -> int | None:
    """Add the chunk at `start` and its message indexes to `found`.

    Return the offset of the next record, or None if the chunk is incomplete.
    """
    stream = ReadDataStream(
        BytesIO(os.pread(descriptor, CHUNK_HEADER_BYTES + MAX_COMPRESSION_NAME, start + RECORD_HEADER_BYTES))
    )
    first, last, uncompressed = stream.read8(), stream.read8(), stream.read8()
    stream.read4()
    compression = str(stream.read(stream.read4()), "ascii")
    content = None
    if verify:
        try:
            content = _content(os.pread(descriptor, end - start - RECORD_HEADER_BYTES, start + RECORD_HEADER_BYTES))
        except (CRCValidationError, ZstdError, EndOfFile, ValueError):
            return None
    offsets: dict[int, int] = {}
    offset = end
    while len(head := os.pread(descriptor, RECORD_HEADER_BYTES + 6, offset)) == RECORD_HEADER_BYTES + 6:
        opcode, length, topic, entries = struct.unpack("<BQHI", head)
        if opcode != Opcode.MESSAGE_INDEX or offset + RECORD_HEADER_BYTES + length > size:
            break
        offsets[topic] = offset
        found.counts[topic] = found.counts.get(topic, 0) + entries // 16
        offset += RECORD_HEADER_BYTES + length
    if content is not None:
        # A kill may happen between writing a chunk and its indexes. Missing indexes are computed from the chunk.
        for topic, listed in _entries(content).items():
            if topic not in offsets:
                offsets[topic] = offset + len(found.repair)
                found.counts[topic] = found.counts.get(topic, 0) + len(listed) // 16
                found.repair += index_record(topic, listed)
    index = ChunkIndex(
        chunk_length=end - start,
        chunk_start_offset=start,
        compression=compression,
        compressed_size=end - start - RECORD_HEADER_BYTES - CHUNK_HEADER_BYTES - len(compression),
        message_start_time=first,
        message_end_time=last,
        message_index_length=offset + len(found.repair) - end,
        message_index_offsets=offsets,
        uncompressed_size=uncompressed,
    )
    _add(found.chunks, index)
    found.chunk_count += 1
    earliest, latest = found.times or (first, last)
    found.times = (min(earliest, first), max(latest, last))
    return offset


def _content(record: bytes) -> bytes:
    """Return the decompressed content of a chunk after a check of its CRC."""
    chunk = Chunk.read(ReadDataStream(BytesIO(record)))
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    return stream.read(length)


def _entries(content: bytes) -> dict[int, bytes]:
    """Return the message index entries of a chunk's content by topic."""
    found: dict[int, bytes] = {}
    offset = 0
    while offset < len(content):
        opcode, length = struct.unpack_from("<BQ", content, offset)
        if opcode == Opcode.MESSAGE:
            topic, _sequence, time = struct.unpack_from("<HIQ", content, offset + RECORD_HEADER_BYTES)
            found[topic] = found.get(topic, b"") + struct.pack("<QQ", time, offset)
        offset += RECORD_HEADER_BYTES + length
    return found


def _tail(found: _Contents, result: Mapping[str, str]) -> bytes:
    """Return the end of the file: missing indexes, result, end of the data, summary and footer."""
    tail = RecordBuilder()
    tail.write(found.repair)
    Metadata(RESULT_RECORD, dict(result)).write(tail)
    offset = len(found.repair)
    _add(found.metadata, MetadataIndex(found.end + offset, tail.count - offset, RESULT_RECORD))
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
