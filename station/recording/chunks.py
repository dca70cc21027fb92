"""Chunks of a recording: check their content, and divide it into messages."""

import struct
from collections.abc import Iterator
from io import BytesIO
from operator import attrgetter
from typing import IO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary
from zstandard import ZstdError

from station.recording.data_section import MESSAGE_HEADER_BYTES

#: Length of the header of an MCAP record: opcode and length of the content [bytes].
RECORD_HEADER_BYTES = 9
#: Length of a chunk's header before its messages, without the name of the compression [bytes].
CHUNK_HEADER_BYTES = 40
#: Exceptions that damaged bytes cause. The mcap library does not document them, so several types are listed.
DAMAGE = (
    McapError, ZstdError, ValueError, KeyError, IndexError, OverflowError, MemoryError, RecursionError, struct.error,
)  # fmt: skip
#: Start of a message record: opcode, length, topic, sequence number and time.
_MESSAGE = struct.Struct("<BQHIQ")


class ChunkMessage(NamedTuple):
    """Message in the content of a chunk."""

    topic: int
    sequence: int
    time: int  #: [ns since 1970]
    start: int  #: offset of its record in the content [bytes]
    end: int  #: offset after its record [bytes]

    def data(self, content: bytes) -> bytes:
        """Return the data of the message, given the content of its chunk."""
        return content[self.start + MESSAGE_HEADER_BYTES : self.end]


def content_of(record: bytes) -> bytes | None:
    """Return the decompressed content of a chunk's record; None if its CRC or its lengths show damage."""
    try:
        opcode, length = struct.unpack_from("<BQ", record)
        chunk = Chunk.read(ReadDataStream(BytesIO(record[RECORD_HEADER_BYTES:])))
        head = CHUNK_HEADER_BYTES + len(chunk.compression)
        (inner,) = struct.unpack_from("<Q", record, RECORD_HEADER_BYTES + head - 8)
        if opcode != Opcode.CHUNK or not length == head + inner == len(record) - RECORD_HEADER_BYTES:
            return None
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        return stream.read(length)
    except DAMAGE:
        return None


def messages(content: bytes, topic: int | None = None) -> Iterator[ChunkMessage]:
    """Yield the messages in the content of a chunk, in the order of the file; `topic` None: of all topics."""
    start = 0
    while start < len(content):
        opcode, length, found, sequence, time = _MESSAGE.unpack_from(content, start)
        end = start + RECORD_HEADER_BYTES + length
        if opcode == Opcode.MESSAGE and topic in (None, found):
            yield ChunkMessage(found, sequence, time, start, end)
        start = end


def chunks_with(file: IO[bytes], summary: Summary, topic: int) -> Iterator[bytes | None]:
    """Yield the content of each chunk with messages of a topic, in the order of the file; None where it is damaged.

    The index of a recovered recording has only its intact chunks; other bytes between two chunks are a damaged chunk.
    """
    after = None
    for index in sorted(summary.chunk_indexes, key=attrgetter("chunk_start_offset")):
        if after not in (None, index.chunk_start_offset):
            yield None
        after = index.chunk_start_offset + index.chunk_length + index.message_index_length
        if topic in index.message_index_offsets:
            try:
                file.seek(index.chunk_start_offset)
                record = file.read(index.chunk_length)
            except OSError:  # a bad sector of the disk
                record = b""
            yield content_of(record)
