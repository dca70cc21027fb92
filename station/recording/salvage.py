"""Copy of a damaged or unfinished recording that is complete: every intact record, then the outcome and the index.

The copy also keeps the damaged bytes, in records that readers skip. So it has everything that the original file has,
and only a complete copy may replace the original file.
"""

import os
import struct
from collections.abc import Mapping
from io import BytesIO
from typing import IO, Any

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from station.recording.chunks import CHUNK_HEADER_BYTES, DAMAGE, RECORD_HEADER_BYTES, content_of, messages
from station.recording.data_section import COMPRESSION, first_bytes, index_record
from station.recording.metadata import values_of
from station.recording.run_outcome import RunOutcome
from station.recording.summary import RESULT_RECORD, FileIndex, chunk_index

#: Opcode of a record with damaged bytes. MCAP reserves the opcodes from 0x80 for applications, and readers skip them.
DAMAGED = 0x80
#: Records that precede the chunks.
_HEAD: Mapping[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
}
#: Length of the content of the record that ends the data [bytes].
_DATA_END_BYTES = 4
#: Longest record [bytes]: a chunk has less than a second of rows or pictures, so a longer one has a damaged length.
MAX_RECORD_BYTES = 1 << 26
#: Bytes by which a chunk is found after damaged bytes: the name of its compression, after the length of this name.
_MARK = struct.pack("<I", len(COMPRESSION)) + COMPRESSION.encode()
#: Offset of these bytes in the record of a chunk [bytes].
_MARK_OFFSET = RECORD_HEADER_BYTES + CHUNK_HEADER_BYTES - 12
#: Number of bytes that are copied or searched at once.
_BLOCK_BYTES = 1 << 20


def is_recording(file: IO[bytes]) -> bool:
    """Return whether a file starts like a recording of this program."""
    first = first_bytes()
    return os.pread(file.fileno(), len(first), 0) == first


def is_empty_recording(file: IO[bytes]) -> bool:
    """Return whether a writer was killed while it wrote the first bytes of a recording."""
    first = first_bytes()
    found = os.pread(file.fileno(), len(first), 0)
    return found != first and first.startswith(found)


def salvage(source: IO[bytes], target: IO[bytes], result: Mapping[str, str]) -> None:
    """Write a complete copy of a recording that may be damaged anywhere and end anywhere.

    Args:
        source: file to read; no process may be writing it.
        target: empty file for the copy.
        result: outcome of the recording, unless the file has an intact one.

    Raises:
        OSError: a file cannot be read or written.
    """
    index, size, descriptor = FileIndex(), os.fstat(source.fileno()).st_size, source.fileno()
    target.write(MCAP0_MAGIC)
    offset = len(MCAP0_MAGIC)
    while offset < size:
        opcode, end = _header(descriptor, offset, size)
        if opcode == DAMAGED:  # of an earlier recovery
            _copy(descriptor, target, offset, end)
            offset = end
            continue
        record = _record(descriptor, offset, size)
        if _is_end(record):
            break
        if (outcome := _outcome(record)) is not None:
            result = outcome
            break
        if (content := content_of(record)) is not None and (after := _add_chunk(target, index, record, content)):
            offset += len(record)
            if os.pread(descriptor, len(after), offset) == after:  # otherwise its message indexes are damaged
                offset += len(after)
        elif _is_intact(record):
            index.add_record(record, target.tell())
            target.write(record)
            offset += len(record)
        else:
            end = _next_chunk(descriptor, offset + 1, size)
            target.write(struct.pack("<BQ", DAMAGED, end - offset))
            _copy(descriptor, target, offset, end)
            offset = end
    target.write(index.tail(target.tell(), result))
    target.flush()


def _header(descriptor: int, offset: int, size: int) -> tuple[int, int]:
    """Return the opcode of the record at an offset, and the offset after it; (0, 0) if the file ends before it does."""
    head = os.pread(descriptor, RECORD_HEADER_BYTES, offset)
    if len(head) < RECORD_HEADER_BYTES:
        return 0, 0
    opcode, length = struct.unpack("<BQ", head)
    end = offset + RECORD_HEADER_BYTES + length
    return (opcode, end) if end <= size else (0, 0)


def _record(descriptor: int, offset: int, size: int) -> bytes:
    """Return the record at an offset; empty if the file ends before it does, or if it is longer than any of ours."""
    length = _header(descriptor, offset, size)[1] - offset
    return os.pread(descriptor, length, offset) if 0 < length <= MAX_RECORD_BYTES else b""


def _is_end(record: bytes) -> bool:
    return record[:1] == bytes([Opcode.DATA_END]) and len(record) == RECORD_HEADER_BYTES + _DATA_END_BYTES


def _is_intact(record: bytes) -> bool:
    """Return whether a record is one of those that precede the chunks, with consistent lengths."""
    kind = _HEAD.get(record[0]) if record else None
    if kind is None:
        return False
    stream = ReadDataStream(BytesIO(record[RECORD_HEADER_BYTES:]))
    try:
        kind.read(stream)
    except DAMAGE:
        return False
    return stream.count == len(record) - RECORD_HEADER_BYTES


def _outcome(record: bytes) -> Mapping[str, str] | None:
    """Return the outcome in a record that an earlier end of the recording has written; None: it is another record."""
    if record[:1] != bytes([Opcode.METADATA]) or not _is_intact(record):
        return None
    metadata = Metadata.read(ReadDataStream(BytesIO(record[RECORD_HEADER_BYTES:])))
    if metadata.name != RESULT_RECORD:
        return None
    return metadata.metadata if is_outcome(metadata.metadata) else None


def is_outcome(written: Mapping[str, str]) -> bool:
    """Return whether the texts of a metadata record are a valid outcome of a recording."""
    values = values_of(written)
    return values.get("label") in {*RunOutcome} and "cause" in values


def _add_chunk(target: IO[bytes], index: FileIndex, record: bytes, content: bytes) -> bytes:
    """Write an intact chunk and its message indexes; return the bytes of the indexes.

    If the chunk has no messages, write nothing and return no bytes.
    The times in the header of a chunk and its message indexes have no CRC, so they are computed from its messages.
    """
    entries: dict[int, bytes] = {}
    times: list[int] = []
    for message in messages(content):
        entries[message.topic] = entries.get(message.topic, b"") + struct.pack("<QQ", message.time, message.start)
        times.append(message.time)
    if not times:
        return b""
    start, first, last = target.tell(), min(times), max(times)
    target.write(record[:RECORD_HEADER_BYTES] + struct.pack("<QQQ", first, last, len(content)))
    target.write(record[RECORD_HEADER_BYTES + 24 :])
    indexes = {topic: index_record(topic, listed) for topic, listed in entries.items()}
    end, offsets = target.tell(), dict[int, int]()
    for topic, each in indexes.items():
        offsets[topic] = target.tell()
        target.write(each)
    counts = {topic: len(listed) // 16 for topic, listed in entries.items()}
    after = target.tell()
    index.add_chunk(chunk_index(start, end, (first, last), COMPRESSION, len(content), offsets, after), counts)
    return b"".join(indexes.values())


def _next_chunk(descriptor: int, offset: int, size: int) -> int:
    """Return the offset of the first intact chunk at or after an offset; the file's size if there is none."""
    block = offset
    while block < size:
        # Blocks overlap, so that no chunk is missed whose mark is at the end of a block.
        part = os.pread(descriptor, _BLOCK_BYTES + len(_MARK), block)
        found = part.find(_MARK)
        while found >= 0:
            start = block + found - _MARK_OFFSET
            if start >= offset and content_of(_record(descriptor, start, size)) is not None:
                return start
            found = part.find(_MARK, found + 1)
        block += _BLOCK_BYTES
    return size


def _copy(descriptor: int, target: IO[bytes], start: int, end: int) -> None:
    while part := os.pread(descriptor, min(_BLOCK_BYTES, end - start), start):
        target.write(part)
        start += len(part)
