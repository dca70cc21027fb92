"""Processes of cameras: pictures on request, and what a stalled, killed, flooding or missing camera reports."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import psutil
import pytest

from station.camera import host as camera_host
from station.camera.host import CameraHost, Cameras
from station.config.robots import RobotFile
from station.control.clock import REAL_TIME_CLOCK
from station.control.process import ring_width
from station.control.ring import Ring
from station.devices.cameras import CameraFile, SimulationFile, measuring
from tests.harness.children import has_ended
from tests.harness.waiting import until

Opened = Callable[..., CameraHost]


@pytest.fixture
def opened(paper: RobotFile) -> Iterator[Opened]:
    """Return a function that opens one camera in a process."""
    with ExitStack() as owned:

        def open_camera(**keys: object) -> CameraHost:
            width = ring_width(paper)
            ring = Ring(width)
            owned.callback(ring.close, remove=True)
            cameras = Cameras(
                {"one": CameraFile(**keys)},
                measuring({"one": CameraFile(**keys)}),
                paper,
                ring,
                width,
                REAL_TIME_CLOCK,
                0,
            )
            cameras.open()
            owned.callback(cameras.close)
            cameras.start()
            (host,) = cameras
            return host

        yield open_camera


def write_video(path: Path, frames: int, size: tuple[int, int] = (640, 480)) -> None:
    """Write a video file of grey frames, whose grey level is the number of the frame."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, size)
    for number in range(frames):
        writer.write(np.full((size[1], size[0], 3), number % 256, np.uint8))
    writer.release()


def test_simulated_camera_delivers_pictures_only_while_a_client_requests_them(opened: Opened) -> None:
    host = opened(rate=30.0, simulation=SimulationFile(latency=0.05))
    until(lambda: host.status().frames > 30 and not host.status().problem)
    assert host.picture is None

    until(lambda: host.watch() or host.picture is not None)
    first = host.picture
    assert first is not None
    picture = cv2.imdecode(np.frombuffer(first.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (480, 640, 3)
    until(lambda: host.watch() or host.picture is not first)
    until(lambda: not host.watched)
    frames = host.status().frames
    until(lambda: host.status().frames > frames + 15)  # the last request has reached the camera and has expired
    last = host.picture
    until(lambda: host.status().frames > frames + 45)
    assert host.picture is last


def test_frame_time_is_the_time_of_the_exposure_before_the_latency(opened: Opened) -> None:
    host = opened(latency=0.2, simulation=SimulationFile(latency=0.2))
    until(lambda: host.watch() or host.picture is not None)

    assert host.picture is not None
    age = REAL_TIME_CLOCK.now() - host.picture.time
    assert age > 0.2


def test_dropped_frames_do_not_arrive(opened: Opened) -> None:
    host = opened(simulation=SimulationFile(dropped=1.0))
    until(lambda: psutil.Process(host.pid).name() == "ctr-camera")
    until(lambda: host.status().problem == "the camera is being opened")
    assert host.status().frames == 0


def test_killed_camera_is_reported_and_replaced(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    host = opened()
    until(lambda: host.status().frames > 0)
    first = host.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)

    until(lambda: "ended by signal 9" in host.status().problem)
    until(lambda: host.pid not in (None, first))
    until(lambda: host.watch() or (not host.status().problem and host.status().frames > 0 and host.picture is not None))


def test_stopped_camera_is_reported_and_replaced(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_host, "HUNG_AFTER_S", 4.0)
    host = opened()
    until(lambda: host.status().frames > 0)
    first = host.pid
    assert first is not None
    os.kill(first, signal.SIGSTOP)

    until(lambda: host.watch() or "has not reported for" in host.status().problem)
    until(lambda: host.pid not in (None, first))
    until(lambda: host.status().frames > 0 and not host.status().problem)


def test_missing_camera_is_reported_and_used_as_soon_as_it_is_connected(opened: Opened, tmp_path: Path) -> None:
    path = tmp_path / "camera.avi"
    host = opened(device=str(path))
    until(lambda: "no such device; connect the camera" in host.status().problem)

    write_video(tmp_path / "other.avi", 600)
    (tmp_path / "other.avi").rename(path)
    until(lambda: host.watch() or host.picture is not None)
    until(lambda: "no more frames" in host.status().problem)  # the end of the file is an unplugged camera
    assert host.status().frames >= 600


def test_flooding_camera_is_reported_and_its_surplus_frames_are_dropped(opened: Opened, tmp_path: Path) -> None:
    path = tmp_path / "camera.avi"
    write_video(path, 3000, (64, 64))
    host = opened(device=str(path), width=64, height=64, rate=10.0)

    until(lambda: host.status().surplus > 1000)


def test_camera_of_another_size_is_refused_with_both_sizes(opened: Opened, tmp_path: Path) -> None:
    write_video(tmp_path / "camera.avi", 5)
    host = opened(device=str(tmp_path / "camera.avi"), width=1280, height=720)

    until(lambda: "delivers 640 x 480 pixels, not 1280 x 720" in host.status().problem)


def test_camera_process_ends_with_its_station(opened: Opened) -> None:
    host = opened()
    until(lambda: host.status().frames > 0)
    process = psutil.Process(host.pid)
    host._child.pipe.close()

    until(lambda: has_ended(process))
