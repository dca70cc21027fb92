"""Sources of frames: a USB camera or a video file through OpenCV, and the camera that the virtual lab simulates.

A frame is first grabbed, which is cheap, and decoded or rendered only if a client or a recording needs its picture.
"""

import os
from collections import deque
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from core.errors import CtrError
from core.robot.robot import Robot
from station.camera.messages import ShowBoard
from station.control.clock import StationClock
from station.control.ring import SHAPE_PORT, Ring
from station.devices.cameras import CameraFile, SimulationFile
from station.devices.projection import true_view_of
from station.lab.plant import TubeShape
from station.lab.shape_server import ShapeClient

# OpenCV reads this variable when it is imported: longest wait for a frame of a USB camera [s].
os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", "1")
import cv2

from station.camera.simulated_board import picture as board_picture
from station.lab.rendering import Picture, Renderer

cv2.setNumThreads(1)
#: Folder of the stable names of USB cameras.
STABLE_NAMES = Path("/dev/v4l/by-id")
#: Number of successive frames that a USB camera fails to deliver, after which it counts as lost.
MAX_FAILED_GRABS = 3


class CameraLost(CtrError):
    """A camera cannot be opened, or no longer delivers frames."""


class Source(Protocol):
    """Source of frames."""

    def grab(self, timeout: float) -> float | None:
        """Wait at most `timeout` [s] for the next frame; return the time of its exposure [s], None: no frame.

        Raises:
            CameraLost: the camera delivers no more frames.
        """
        ...

    def retrieve(self) -> Picture | None:
        """Return the picture of the grabbed frame; None: it cannot be decoded."""
        ...

    def show_board(self, board: ShowBoard | None) -> None:
        """Show a calibration board instead of the robot; None: the robot. A real camera ignores it."""
        ...

    def close(self) -> None:
        """Release the camera."""
        ...


class UsbCamera:
    """A USB camera, or a video file. The frames of a file arrive as fast as they are read."""

    def __init__(self, camera: CameraFile, clock: StationClock) -> None:
        """Open the camera.

        Raises:
            CameraLost: the device does not exist or is not a camera.
        """
        self._camera, self._clock, self._failed = camera, clock, 0
        path = Path(camera.device)
        if not path.exists():
            listed = sorted(one.name for one in STABLE_NAMES.iterdir()) if STABLE_NAMES.is_dir() else []
            raise CameraLost(
                f"{path}: no such device; connect the camera, or choose one of {', '.join(listed) or 'no camera'}"
                f" in {STABLE_NAMES}"
            )
        usb = path.resolve().is_char_device()
        # OpenCV opens a V4L2 device by the number in its name, which the stable name links to.
        self._capture = cv2.VideoCapture(str(path.resolve()), cv2.CAP_V4L2 if usb else cv2.CAP_ANY)
        if not self._capture.isOpened():
            raise CameraLost(f"{path}: cannot be opened as a camera; end other programs that use it")
        if usb:
            self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, camera.width)
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, camera.height)
            self._capture.set(cv2.CAP_PROP_FPS, camera.rate)
            self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 2)
        size = tuple(int(self._capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if size != (camera.width, camera.height):
            self._capture.release()
            raise CameraLost(
                f"{path}: the camera delivers {size[0]} x {size[1]} pixels, not {camera.width} x {camera.height};"
                " change width and height in the station file"
            )

    def grab(self, timeout: float) -> float | None:  # noqa: ARG002 - OpenCV waits for at most a second
        """Wait for the next frame; see `Source`."""
        if self._capture.grab():
            self._failed = 0
            return self._clock.now() - self._camera.latency
        self._failed += 1
        if self._failed >= MAX_FAILED_GRABS or not Path(self._camera.device).exists():
            raise CameraLost(f"{self._camera.device}: no more frames; check the cable")
        return None

    def retrieve(self) -> Picture | None:
        """Decode the grabbed frame."""
        good, picture = self._capture.retrieve()
        return np.ascontiguousarray(picture, np.uint8) if good else None

    def show_board(self, board: ShowBoard | None) -> None:
        """Do nothing: a person holds the board in front of a real camera."""

    def close(self) -> None:
        """Release the camera."""
        self._capture.release()


class _Exposure(NamedTuple):
    """Frame of a simulated camera that has not arrived yet."""

    arrival: float  #: time of arrival, by the station's clock [s]
    shape: TubeShape | None


class SimulatedCamera:
    """Camera of the virtual lab: it renders the true shape of the tubes, and its frames arrive with latency."""

    def __init__(self, camera: CameraFile, robot: Robot, ring: Ring, clock: StationClock, seed: int) -> None:
        self._camera, self._ring, self._clock = camera, ring, clock
        self._simulation = camera.simulation or SimulationFile()
        view = true_view_of(camera)
        if view is None:
            raise CameraLost("a simulated camera needs a lens and a pose; add both to its table")
        self._view, self._renderer = view, Renderer(robot, camera, view, seed)
        self._board: ShowBoard | None = None
        self._board_picture: tuple[int, Picture] | None = None  # number of the pose, and its picture
        self._exposed = 0.0  # time of the grabbed frame [s]
        self._random = np.random.default_rng((seed, 1))
        self._client = ShapeClient()
        self._due = clock.now()
        self._coming: deque[_Exposure] = deque()
        self._shape: TubeShape | None = None

    def grab(self, timeout: float) -> float | None:
        """Wait for the next frame; see `Source`."""
        end = self._clock.now() + timeout
        while True:
            now = self._clock.now()
            if self._coming and self._coming[0].arrival <= now:
                arrival, self._shape = self._coming.popleft()
                self._exposed = arrival - self._camera.latency
                return self._exposed
            if now >= self._due:
                self._expose(now)
                continue
            then = min(self._due, self._coming[0].arrival if self._coming else self._due)
            if then > end:
                self._clock.sleep(max(0.0, end - now))
                return None
            self._clock.sleep(then - now)

    def retrieve(self) -> Picture | None:
        """Render the grabbed frame."""
        board = self._board
        if board is None:
            return self._renderer.render(self._shape)
        number = int(max(0.0, self._exposed - board.start) / board.each) % len(board.poses)
        if self._board_picture is None or self._board_picture[0] != number:  # rendering takes longer than a frame
            size = (self._camera.width, self._camera.height)
            shown = board_picture(self._view, size, board.square, *board.poses[number], self._random)
            self._board_picture = number, shown
        return self._board_picture[1]

    def show_board(self, board: ShowBoard | None) -> None:
        """Show a calibration board; see `Source`."""
        self._board, self._board_picture = board, None

    def close(self) -> None:
        """Close the connection to the lab."""
        self._client.close()

    def _expose(self, now: float) -> None:
        """Request the present shape from the lab; it arrives as a frame after the latency, unless it is dropped."""
        self._due = max(self._due + 1.0 / self._camera.rate, now)
        port = int(self._ring.numbers[SHAPE_PORT])
        timed = self._client.request(port) if port else None
        if self._random.random() >= self._simulation.dropped:
            time, shape = (now, None) if timed is None else timed
            self._coming.append(_Exposure(time + self._simulation.latency, shape))


def open_source(camera: CameraFile, robot: Robot, ring: Ring, clock: StationClock, seed: int) -> Source:
    """Open the camera that a station file describes.

    Raises:
        CameraLost: the camera cannot be opened; the message has instructions.
    """
    return SimulatedCamera(camera, robot, ring, clock, seed) if camera.simulated else UsbCamera(camera, clock)
