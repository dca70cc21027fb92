"""Message of a camera's process to the driver: where the ball was seen in one frame, as one datagram."""

import math
import struct
from typing import NamedTuple

#: First bytes of a datagram; the last one is the number of the format.
MAGIC = b"CTRBALL\x01"
#: Magic, name of the camera, number of the frame, then exposure, sending, column and row as little-endian numbers.
FORMAT = struct.Struct("<8s64sQdddd")


class Sighting(NamedTuple):
    """The ball in one frame of one camera."""

    camera: str  #: name of the camera in the station file
    frame: int  #: number of the frame, counted by the camera's process
    exposed: float  #: time of the exposure by the station's clock [s]
    sent: float  #: time at which the datagram was sent, by the same clock [s]
    column: float  #: centre of the ball [pixel]; NaN: the frame shows no ball
    row: float  #: centre of the ball [pixel]; NaN: the frame shows no ball

    @property
    def visible(self) -> bool:
        """Whether the frame shows the ball."""
        return math.isfinite(self.column + self.row)


def pack(sighting: Sighting) -> bytes:
    """Return a sighting as a datagram."""
    name = sighting.camera.encode()[:64]
    return FORMAT.pack(MAGIC, name, sighting.frame, *sighting[2:])


def unpack(datagram: bytes) -> Sighting | None:
    """Return the sighting in a datagram; None if it is damaged or of another program."""
    if len(datagram) != FORMAT.size or not datagram.startswith(MAGIC):
        return None
    _, name, frame, exposed, sent, column, row = FORMAT.unpack(datagram)
    if not (math.isfinite(exposed) and math.isfinite(sent)) or math.isnan(column) != math.isnan(row):
        return None
    if math.isinf(column) or math.isinf(row):
        return None
    return Sighting(name.rstrip(b"\0").decode(errors="replace"), frame, exposed, sent, column, row)
