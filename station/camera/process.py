"""The process of one camera, `ctr-camera`: it captures frames, and encodes them only while they are needed.

The process receives messages of the station process through a pipe and sends reports and pictures back. It has no
access to the control loop: a camera that stalls, floods or dies delays only its own pictures.
"""

import contextlib
import math
import os
import signal
import socket
from collections import deque
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from station.camera.messages import CameraOrder, CameraPicture, CameraReport, EndVideo, ShowBoard, StartVideo, Watch
from station.config.robots import RobotFile
from station.control.clock import StationClock
from station.control.guard import Rank, watching
from station.control.realtime import set_process_name
from station.control.ring import BALL_PORT, Ring
from station.devices.cameras import CameraFile

if TYPE_CHECKING:
    from station.camera.sources import Source
    from station.camera.video import VideoWriter
    from station.lab.rendering import Picture

#: Longest wait for a frame before the messages are read again [s].
GRAB_TIMEOUT_S = 0.05
#: Interval between two reports, and between two attempts to open a camera [s].
REPORT_INTERVAL_S, RETRY_INTERVAL_S = 0.25, 1.0
#: Time over which the rate of the frames is averaged [s].
RATE_SPAN_S = 2.0
#: Largest number of pictures that clients receive in a second, and their JPEG quality, 0 ... 100.
PICTURES_PER_S, JPEG_QUALITY = 15.0, 80
#: Fraction of the interval between two frames below which a frame is surplus and is not decoded.
SURPLUS = 0.5
#: Niceness of the process: all other processes of the station have priority, unless the camera measures the tip.
NICENESS = 5


@dataclass(frozen=True)
class CameraSetup:
    """Start parameters of a camera's process."""

    name: str
    camera: CameraFile
    known: CameraFile  #: the camera as the station knows it: calibrated, and without simulated errors
    robot: RobotFile
    ring_name: str
    ring_width: int
    clock: StationClock
    seed: int
    tracks: bool = False  #: whether the camera's pictures measure the tip


def run_camera(setup: CameraSetup, pipe: Connection, parent: int) -> None:
    """Main function of a camera's process."""
    signals: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: signals.append(number))
    set_process_name("ctr-camera")
    if not setup.tracks:
        os.nice(NICENESS)
    with (
        watching(setup.ring_name, setup.ring_width, Rank.CAMERA, setup.clock, parent) as ring,
        contextlib.closing(_Capture(setup, ring, pipe)) as capture,
        contextlib.suppress(EOFError, OSError),  # the station process has ended
    ):
        while not signals and os.getppid() == parent and capture.step():
            pass


class _Capture:
    """Capture loop of one camera."""

    def __init__(self, setup: CameraSetup, ring: Ring, pipe: Connection) -> None:
        self._setup, self._ring, self._pipe, self._clock = setup, ring, pipe, setup.clock
        self._source: Source | None = None
        self._problem = "the camera is being opened"
        self._retry = self._report_due = 0.0
        self._watched_until = self._picture_due = 0.0
        self._arrivals: deque[float] = deque()
        self._frames = self._surplus = 0
        self._newest: float | None = None
        self._start: StartVideo | None = None  # order for a video that starts with the next frame
        self._video: VideoWriter | None = None
        self._recorded, self._video_problem = 0, ""
        self._board: ShowBoard | None = None
        self._to_driver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)  # sends the ball's pixels to `stereo`

    def step(self) -> bool:
        """Process messages and at most one frame; return False if the station process has requested the end."""
        while self._pipe.poll():
            message: CameraOrder | None = self._pipe.recv()
            match message:
                case None:
                    return False
                case Watch():
                    self._watched_until = message.until
                case StartVideo():
                    self._start_video(message)
                case EndVideo():
                    self._end_video()
                case ShowBoard():
                    self._board = message if message.square > 0.0 else None
                    if self._source is not None:
                        self._source.show_board(self._board)
        if self._source is None:
            self._open()
        if self._source is not None:
            self._grab(self._source)
        self._report()
        return True

    def close(self) -> None:
        """Finish the video and release the camera."""
        self._end_video()
        self._release()
        self._to_driver.close()

    def _release(self) -> None:
        if self._source is not None:
            self._source.close()
            self._source = None

    def _start_video(self, start: StartVideo) -> None:
        """Start a video with the next frame, so that a camera without frames leaves no empty file."""
        self._end_video()
        self._recorded, self._video_problem = 0, ""
        self._start = start

    def _end_video(self) -> None:
        from station.recording.run_outcome import RecordingError

        video, self._video, self._start = self._video, None, None
        if video is not None:
            try:
                video.close()
            except RecordingError as error:
                self._video_problem = self._video_problem or str(error)

    def _record(self, picture: "Picture", exposed: float) -> None:
        from station.camera.video import VideoWriter, next_video
        from station.recording.run_outcome import RecordingError

        start, self._start = self._start, None
        try:
            if start is not None:
                if not start.folder.parent.is_dir():
                    return  # the run ended before the first frame
                setup = self._setup
                self._video = VideoWriter(next_video(start.folder, setup.name), setup.name, setup.known, start.epoch)
            if self._video is not None:
                self._video.write(picture, exposed)
                self._recorded = self._video.frames
        except RecordingError as error:
            self._video_problem = str(error)
            self._end_video()

    def _open(self) -> None:
        if self._clock.now() < self._retry:
            self._pipe.poll(self._clock.real(GRAB_TIMEOUT_S))
            return
        import station.camera.video  # noqa: F401 - at the start of a run, frames would have to wait for this import
        from station.camera.sources import CameraLost, open_source  # imports OpenCV

        setup = self._setup
        try:
            self._source = open_source(setup.camera, setup.robot.robot(), self._ring, self._clock, setup.seed)
            self._source.show_board(self._board)
        except CameraLost as error:
            self._lost(str(error))

    def _lost(self, problem: str) -> None:
        self._release()
        self._problem, self._retry = problem, self._clock.now() + RETRY_INTERVAL_S

    def _grab(self, source: "Source") -> None:
        from station.camera.sources import CameraLost

        try:
            exposed = source.grab(GRAB_TIMEOUT_S)
        except CameraLost as error:
            self._lost(str(error))
            return
        if exposed is None:
            return
        self._problem, self._frames = "", self._frames + 1
        self._arrivals.append(self._clock.now())
        if self._newest is not None and 0.0 <= exposed - self._newest < SURPLUS / self._setup.camera.rate:
            self._surplus += 1
            return
        self._newest = exposed
        viewed = exposed >= self._picture_due and self._clock.now() < self._watched_until
        recorded = self._video is not None or self._start is not None
        driver = int(self._ring.numbers[BALL_PORT]) if self._setup.tracks else 0
        if not viewed and not recorded and not driver:
            return
        picture = source.retrieve()
        if picture is None:
            return
        if driver:
            self._send_ball(picture, exposed, driver)
        if recorded:
            self._record(picture, exposed)
        if viewed:
            self._picture_due = max(self._picture_due + 1.0 / PICTURES_PER_S, exposed)
            self._send_picture(picture, exposed)

    def _send_ball(self, picture: "Picture", exposed: float, port: int) -> None:
        """Find the ball and send its pixels to the driver at a UDP port of this computer."""
        from station.devices.stereo.ball import find_ball  # imports OpenCV
        from station.devices.stereo.sighting import Sighting, pack

        ball = find_ball(picture, self._setup.camera.ball)
        at = (math.nan, math.nan) if ball is None else (ball.column, ball.row)
        sighting = Sighting(self._setup.name, self._frames, exposed, self._clock.now(), *at)
        with contextlib.suppress(OSError):  # the control process is being replaced
            self._to_driver.sendto(pack(sighting), ("127.0.0.1", port))

    def _send_picture(self, picture: "Picture", exposed: float) -> None:
        import cv2

        good, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if good:
            self._pipe.send(CameraPicture(self._frames, exposed, jpeg.tobytes()))

    def _report(self) -> None:
        now = self._clock.now()
        if now < self._report_due:
            return
        self._report_due = now + REPORT_INTERVAL_S
        while self._arrivals and now - self._arrivals[0] > RATE_SPAN_S:
            self._arrivals.popleft()
        rate = len(self._arrivals) / RATE_SPAN_S
        self._pipe.send(
            CameraReport(
                self._problem, rate, self._frames, self._surplus, self._newest, self._recorded, self._video_problem
            )
        )
