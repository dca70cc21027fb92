"""Decoder of the videos of recordings, for tests that judge their pictures."""

from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from station.camera.video import read_frames


def decode_frames(path: Path) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield wall time [ns since 1970] and picture (rows, columns, 3) of each frame of a video file."""
    decoder = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    times: list[int] = []
    for stamp, data in read_frames(path):
        times.append(stamp)
        for frame in decoder.decode(av.Packet(data)):
            yield times.pop(0), frame.to_ndarray(format="bgr24")
    for frame in decoder.decode(None):
        yield times.pop(0), frame.to_ndarray(format="bgr24")
