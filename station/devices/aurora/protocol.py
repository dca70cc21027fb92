"""Framing of NDI's Combined API for an Aurora tracker: commands and replies as bytes, without port and clock.

A command consists of text, the CRC of the text and a carriage return. Most replies have the same form. The reply to the
command BX is binary: C4 A5, body length, CRC of the header, body, CRC of the body, all little-endian. The reader drops
and counts bytes without a correct CRC. `replies.py` parses the replies.
Formats and numbers follow the manufacturer's Combined API as public clients implement it. Values that were not
confirmed on a real tracker are marked as unconfirmed.
"""

import re
import struct

from core.compiled import compiled
from core.errors import CtrError

#: Codes of the rates [bit/s] in the command COMM; after power-up the unit uses 9600.
BAUD_CODES = {
    9600: "0",
    14400: "1",
    19200: "2",
    38400: "3",
    57600: "4",
    115200: "5",
    921600: "6",
    1228739: "7",
    230400: "A",
}
POWER_UP_BAUD = 9600
START_SEQUENCE = b"\xc4\xa5"  #: first bytes of a binary reply
MAX_TEXT_BYTES = 4096  #: longest text reply; longer text counts as noise [bytes]
MAX_BODY_BYTES = 1 + 255 * 42 + 2  #: longest body of a BX reply, with one entry for each possible handle [bytes]


class AuroraError(CtrError):
    """The unit refused a command, did not answer, or gave an invalid answer."""


@compiled
def crc16(data: bytes) -> int:
    """Return the CRC-16/ARC: polynomial x^16 + x^15 + x^2 + 1, reflected, initial value 0, no final XOR."""
    crc = 0
    for k in range(len(data)):
        crc ^= data[k]
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return crc


def framed(text: str) -> bytes:
    """Return a command such as `PHSR:02` or a text reply such as `OKAY`, with CRC and CR."""
    data = text.encode("ascii")
    return data + b"%04X\r" % crc16(data)


def binary(body: bytes) -> bytes:
    """Return a binary reply with `body`."""
    header = START_SEQUENCE + struct.pack("<H", len(body))
    return header + struct.pack("<H", crc16(header)) + body + struct.pack("<H", crc16(body))


_TEXT_END = re.compile(rb"[\r\x80-\xff]")
_PERHAPS_A_START = re.compile(rb"[\x00-\x7f\xc4]")


class ReplyReader:
    """Splits a byte stream into replies, however the stream was divided into reads; without I/O."""

    def __init__(self) -> None:
        self.noise = 0  #: bytes that belonged to no reply
        self.crc_errors = 0  #: texts and binary bodies whose CRC was wrong
        self._buffer = bytearray()
        crc16(b"")  # loads the compiled code here, not in the control loop

    def feed(self, data: bytes) -> list[str | bytes]:
        """Return the replies that `data` completes: text as str, the body of a binary reply as bytes."""
        self._buffer += data
        replies: list[str | bytes] = []
        while self._buffer:
            if not (self._text(replies) if self._buffer[0] < 0x80 else self._binary(replies)):
                break
        return replies

    def drop(self) -> None:
        """Discard an incomplete reply."""
        self._skip(len(self._buffer))

    def _skip(self, count: int) -> None:
        self.noise += count
        del self._buffer[:count]

    def _text(self, replies: list[str | bytes]) -> bool:
        """Remove a text reply or noise from the buffer; return False if more bytes are needed."""
        found = _TEXT_END.search(self._buffer)
        if found is None:
            if len(self._buffer) <= MAX_TEXT_BYTES:
                return False
            self.drop()
            return True
        end = found.start()
        if self._buffer[end] != 0x0D:
            self._skip(end)
        elif end >= 4 and self._buffer[end - 4 : end] == b"%04X" % crc16(bytes(self._buffer[: end - 4])):
            replies.append(self._buffer[: end - 4].decode("ascii"))
            del self._buffer[: end + 1]
        else:
            self.crc_errors += 1
            self._skip(end + 1)
        return True

    def _binary(self, replies: list[str | bytes]) -> bool:
        """Remove a complete binary reply or noise from the buffer; return False if more bytes are needed."""
        if not START_SEQUENCE.startswith(self._buffer[:2]):
            return self._skip_to_a_start()
        if len(self._buffer) < 6:
            return False
        length, check = struct.unpack_from("<HH", self._buffer, 2)
        if check != crc16(bytes(self._buffer[:4])) or length > MAX_BODY_BYTES:
            return self._skip_to_a_start()
        if len(self._buffer) < length + 8:
            return False
        body = bytes(self._buffer[6 : 6 + length])
        if struct.unpack_from("<H", self._buffer, 6 + length)[0] == crc16(body):
            replies.append(body)
            del self._buffer[: length + 8]
            return True
        # Skip only to the next possible start: if bytes were lost, the next reply starts within these bytes.
        self.crc_errors += 1
        return self._skip_to_a_start()

    def _skip_to_a_start(self) -> bool:
        """Drop the first byte and all bytes up to the next possible start of a reply."""
        found = _PERHAPS_A_START.search(self._buffer, 1)
        self._skip(found.start() if found else len(self._buffer))
        return True
