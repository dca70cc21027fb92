"""End of an MCAP file: the outcome and the index.

The regular end of a recording and the recovery after a kill (`salvage.py`) write the same end.
"""

import os
import struct
import zlib
from collections.abc import Mapping
from io import BytesIO
from typing import IO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, DataEnd, Footer, Metadata, MetadataIndex, Statistics, SummaryOffset
from mcap.writer import MCAP0_MAGIC

from station.recording.chunks import CHUNK_HEADER_BYTES, RECORD_HEADER_BYTES

#: Name of the metadata record with the outcome of the recording.
RESULT_RECORD = "result"
#: Longest name of a chunk's compression [bytes].
MAX_COMPRESSION_NAME = 16
#: Number of bytes of which a CRC is computed at once.
CRC_BLOCK_BYTES = 1 << 20


class FileIndex:
    """Index of an MCAP file, built record by record."""

    def __init__(self) -> None:
        self._schemas, self._topics, self._chunks, self._metadata = bytearray(), bytearray(), bytearray(), bytearray()
        self._counts: dict[int, int] = {}  # number of messages by topic
        self._schema_count = self._chunk_count = self._metadata_count = 0
        self._times: tuple[int, int] | None = None  # times of the first and the last message [ns]

    def add_record(self, record: bytes, start: int) -> None:
        """Add a record that is not a chunk, at the offset `start` of the file."""
        opcode = record[0]
        if opcode == Opcode.METADATA:
            name = Metadata.read(ReadDataStream(BytesIO(record[RECORD_HEADER_BYTES:]))).name
            _add(self._metadata, MetadataIndex(start, len(record), name))
            self._metadata_count += 1
        elif opcode == Opcode.SCHEMA:
            self._schemas += record
            self._schema_count += 1
        elif opcode == Opcode.CHANNEL:
            self._topics += record
            self._counts[struct.unpack_from("<H", record, RECORD_HEADER_BYTES)[0]] = 0

    def add_chunk(self, index: ChunkIndex, counts: Mapping[int, int]) -> None:
        """Add a chunk; `counts` is its number of messages by topic."""
        _add(self._chunks, index)
        self._chunk_count += 1
        for topic, count in counts.items():
            self._counts[topic] = self._counts.get(topic, 0) + count
        first, last = index.message_start_time, index.message_end_time
        earliest, latest = self._times or (first, last)
        self._times = (min(earliest, first), max(latest, last))

    def tail(self, start: int, result: Mapping[str, str]) -> bytes:
        """Return the end of the file from the offset `start`: result, end of the data, summary and footer."""
        tail = RecordBuilder()
        Metadata(RESULT_RECORD, dict(result)).write(tail)
        metadata = bytearray(self._metadata)
        _add(metadata, MetadataIndex(start, tail.count, RESULT_RECORD))
        DataEnd(0).write(tail)
        start += tail.count
        first, last = self._times or (0, 0)
        statistics = bytearray()
        _add(
            statistics,
            Statistics(
                attachment_count=0,
                channel_count=len(self._counts),
                channel_message_counts=self._counts,
                chunk_count=self._chunk_count,
                message_count=sum(self._counts.values()),
                message_end_time=last,
                message_start_time=first,
                metadata_count=self._metadata_count + 1,
                schema_count=self._schema_count,
            ),
        )
        summary, offsets = bytearray(), RecordBuilder()
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._topics),
            (Opcode.STATISTICS, statistics),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, metadata),
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


def finish_file(file: IO[bytes], result: Mapping[str, str]) -> None:
    """Write the end of an MCAP file that has only complete records.

    Args:
        file: file without a buffer, which this process has locked.
        result: outcome of the recording.

    Raises:
        OSError: the file cannot be written; its records stay unchanged, and a recovery can finish it.
    """
    index, end = _index(file.fileno())
    file.seek(end)
    tail = memoryview(index.tail(end, result))
    while tail:
        tail = tail[file.write(tail) or 0 :]
    os.fsync(file.fileno())


def ends_intact(file: IO[bytes]) -> bool:
    """Return whether the end of an MCAP file is intact, according to its CRC; other files have no intact end."""
    size = file.seek(0, os.SEEK_END)
    checked = size - len(MCAP0_MAGIC) - 4  # the CRC covers everything from the summary to this offset
    footer = checked - RECORD_HEADER_BYTES - 8 - 8
    if footer < 0:
        return False
    file.seek(footer)
    opcode, length, start, _, crc = struct.unpack("<BQQQI", file.read(RECORD_HEADER_BYTES + 8 + 8 + 4))
    if opcode != Opcode.FOOTER or length != 8 + 8 + 4 or not 0 < start <= footer or file.read() != MCAP0_MAGIC:
        return False
    file.seek(start)
    found, left = 0, checked - start
    while left > 0:  # a damaged offset may make it as long as the file
        block = file.read(min(left, CRC_BLOCK_BYTES))
        found, left = zlib.crc32(block, found), left - len(block)
    return found == crc


def _index(descriptor: int) -> tuple[FileIndex, int]:
    """Return the index of a file with complete records, and the offset after the last record."""
    index, offset = FileIndex(), len(MCAP0_MAGIC)
    while len(head := os.pread(descriptor, RECORD_HEADER_BYTES, offset)) == RECORD_HEADER_BYTES:
        opcode, length = struct.unpack("<BQ", head)
        start, offset = offset, offset + RECORD_HEADER_BYTES + length
        if opcode == Opcode.CHUNK:
            offset = _add_chunk(index, descriptor, start, offset)
        else:
            index.add_record(os.pread(descriptor, offset - start, start), start)
    return index, offset


def _add_chunk(index: FileIndex, descriptor: int, start: int, end: int) -> int:
    """Add the chunk between two offsets, with its message indexes; return the offset after them."""
    head = os.pread(descriptor, CHUNK_HEADER_BYTES + MAX_COMPRESSION_NAME, start + RECORD_HEADER_BYTES)
    stream = ReadDataStream(BytesIO(head))
    first, last, uncompressed = stream.read8(), stream.read8(), stream.read8()
    stream.read4()
    compression = str(stream.read(stream.read4()), "ascii")
    counts: dict[int, int] = {}
    offsets: dict[int, int] = {}
    offset = end
    while len(head := os.pread(descriptor, RECORD_HEADER_BYTES + 6, offset)) == RECORD_HEADER_BYTES + 6:
        opcode, length, topic, entries = struct.unpack("<BQHI", head)
        if opcode != Opcode.MESSAGE_INDEX:
            break
        offsets[topic], counts[topic] = offset, entries // 16
        offset += RECORD_HEADER_BYTES + length
    index.add_chunk(chunk_index(start, end, (first, last), compression, uncompressed, offsets, offset), counts)
    return offset


def chunk_index(
    start: int, end: int, times: tuple[int, int], compression: str, uncompressed: int, offsets: dict[int, int],
    after: int,
) -> ChunkIndex:  # fmt: skip
    """Return the index record of a chunk.

    Args:
        start, end: offsets of the chunk's record and of its end [bytes].
        times: times of its first and last message [ns].
        compression: name of its compression.
        uncompressed: length of its content [bytes].
        offsets: offset of the message index of each topic [bytes].
        after: offset after the message indexes [bytes].
    """
    return ChunkIndex(
        chunk_length=end - start,
        chunk_start_offset=start,
        compression=compression,
        compressed_size=end - start - RECORD_HEADER_BYTES - CHUNK_HEADER_BYTES - len(compression),
        message_start_time=times[0],
        message_end_time=times[1],
        message_index_length=after - end,
        message_index_offsets=offsets,
        uncompressed_size=uncompressed,
    )


def _add(records: bytearray, record: ChunkIndex | MetadataIndex | Statistics) -> None:
    builder = RecordBuilder()
    record.write(builder)
    records += builder.end()
