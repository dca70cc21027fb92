"""Message of a camera's process to the driver: where the ball was seen in one frame, as one datagram."""

import math
import struct
import zlib
from typing import NamedTuple

#: First bytes of a datagram; the last of them is the version of the format.
MAGIC = b"CTRBALL\x02"
#: Fields of a datagram: `MAGIC`, name of the camera, number of the frame, times of exposure and sending, column and
#: row; little-endian. Their CRC-32 follows, because a damaged time would spoil the clock of all later frames.
FORMAT, CHECK = struct.Struct("<8s64sQdddd"), struct.Struct("<I")


class Sighting(NamedTuple):
    """The ball in one frame of one camera."""

    camera: str  #: name of the camera in the station file
    frame: int  #: number of the frame, counted by the camera's process
    exposed: float  #: time of the exposure by the station's clock [s]
    sent: float  #: time at which the datagram was sent, by the same clock [s]
    column: float  #: column of the ball's centre [pixel]; NaN: the frame shows no ball; infinite: several balls
    row: float  #: row of the centre [pixel], with the same special values

    @property
    def visible(self) -> bool:
        """Whether the frame shows exactly one ball."""
        return math.isfinite(self.column + self.row)

    @property
    def ambiguous(self) -> bool:
        """Whether the frame shows several balls."""
        return math.isinf(self.column)


def pack(sighting: Sighting) -> bytes:
    """Return a sighting as a datagram."""
    name = sighting.camera.encode()[:64]
    data = FORMAT.pack(MAGIC, name, sighting.frame, *sighting[2:])
    return data + CHECK.pack(zlib.crc32(data))


def unpack(datagram: bytes) -> Sighting | None:
    """Return the sighting in a datagram; None if it is damaged or of another program."""
    data, check = datagram[: FORMAT.size], datagram[FORMAT.size :]
    if len(data) != FORMAT.size or not data.startswith(MAGIC) or check != CHECK.pack(zlib.crc32(data)):
        return None
    _, name, frame, exposed, sent, column, row = FORMAT.unpack(data)
    if not (math.isfinite(exposed) and math.isfinite(sent)) or math.isnan(column) != math.isnan(row):
        return None
    if math.isinf(column) != math.isinf(row):
        return None
    return Sighting(name.rstrip(b"\0").decode(errors="replace"), frame, exposed, sent, column, row)
