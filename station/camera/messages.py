"""Messages between the station process and the process of a camera."""

from pathlib import Path
from typing import NamedTuple

from core.robot.robot import Array


class Watch(NamedTuple):
    """Message of the station process: clients need pictures until the time `until`."""

    until: float  #: time until which pictures are needed, by the station's clock [s]


class StartVideo(NamedTuple):
    """Message of the station process: record a video until `EndVideo`."""

    folder: Path  #: folder of the run's videos
    epoch: int  #: wall time at which the station's clock was 0 [ns since 1970]


class EndVideo(NamedTuple):
    """Message of the station process: finish the video, if one is recorded."""


class ShowBoard(NamedTuple):
    """Message of the station process: a simulated camera shows a calibration board instead of the robot."""

    square: float  #: side of the board's squares [m]; 0: show the robot again
    poses: tuple[tuple[Array, Array], ...]  #: successive poses of the board: rotation and position
    start: float  #: time of the first pose, by the station's clock [s]
    each: float  #: duration of each pose [s]


class CameraPicture(NamedTuple):
    """Message of the camera: a picture for the clients."""

    number: int  #: number of the frame, from 1
    time: float  #: time of the exposure, by the station's clock [s]
    jpeg: bytes


class CameraReport(NamedTuple):
    """Message of the camera, sent at regular intervals."""

    problem: str  #: why there are no frames; empty if there are
    rate: float  #: rate of the arriving frames [1/s]
    frames: int  #: number of frames since the start
    surplus: int  #: number of frames that came too fast and were dropped
    newest: float | None  #: exposure of the newest frame by the station's clock [s]; None: no frame yet
    video: int = 0  #: number of frames in the video of the present run, or of the last one
    video_problem: str = ""  #: why the video ended before its run; empty otherwise


CameraMessage = CameraPicture | CameraReport
CameraOrder = Watch | StartVideo | EndVideo | ShowBoard
