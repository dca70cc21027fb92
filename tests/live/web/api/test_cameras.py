"""Cameras of a running station over REST: list, snapshot, stream, overlay, and failures that end no run."""

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import cv2
import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

from station.devices.cameras import CameraFile
from station.devices.projection import view_of
from tests.harness.camera_ball import ball_centre
from tests.harness.children import children
from tests.harness.serving import Served, serving
from tests.harness.waiting import until

#: Two simulated cameras at right angles, and one that does not exist.
SETTINGS = """
[cameras.side]
simulation = { ball = 0.006 }

[cameras.top]
pose = { position = [-0.4, 0.0, 0.13], rotation_vector = [2.221441469079183, 0.0, 2.221441469079183] }

[cameras.usb]
device = "/dev/v4l/by-id/usb-none-video-index0"
"""


@pytest.fixture(scope="module")
def running() -> Iterator[Served]:
    with serving(settings=SETTINGS) as served:
        yield served


def cameras(station: Served) -> dict[str, dict[str, Any]]:
    return {camera["name"]: camera for camera in station.rest.get("/api/cameras").json()}


def decoded(jpeg: bytes) -> NDArray[np.uint8]:
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, np.uint8)


def test_cameras_are_listed_with_their_state(station: Served) -> None:
    def listed() -> dict[str, dict[str, Any]] | None:
        """Return the cameras as soon as the process of each has reported."""
        now = cameras(station)
        reported = (
            not now["side"]["problem"] and not now["top"]["problem"] and "no such device" in now["usb"]["problem"]
        )
        return now if reported else None

    found = until(listed)
    assert found is not None

    assert list(found) == ["side", "top", "usb"]
    assert found["side"]["simulated"]
    assert found["side"]["calibrated"]
    assert "no such device" in found["usb"]["problem"]
    assert not found["usb"]["calibrated"]
    lights = station.wait_for(lambda status: status["devices"]["camera side"]["severity"] == 0)["devices"]
    assert lights["camera usb"] == {"severity": 1, "condition": "fault", "text": found["usb"]["problem"]}


def test_snapshot_shows_the_ball_at_the_true_tip_and_the_overlay_is_near(station: Served) -> None:
    answer = station.rest.get("/api/cameras/side/snapshot")
    assert answer.headers["content-type"] == "image/jpeg"
    assert "content-encoding" not in answer.headers
    overlay = station.rest.get("/api/cameras/side/overlay").json()
    view, tip = view_of(CameraFile()), np.array(station.status()["tip_true"])
    assert view is not None

    measured = ball_centre(decoded(answer.content))
    assert np.abs(measured - view.project(tip[None])[0]).max() < 0.5
    assert overlay["reason"] == ""
    assert (overlay["width"], overlay["height"]) == (640, 480)
    assert np.abs(measured - overlay["tip_measured"]).max() < 2.0  # the tracker's noise is 0.1 mm
    assert np.abs(measured - overlay["tubes"][0][-1]).max() < 40.0  # the model's tubes differ by 5 % from the true ones
    assert overlay["tip_desired"] is None


def test_stream_has_new_pictures_while_a_client_reads_and_none_are_encoded_afterwards(station: Served) -> None:
    with station.rest.stream("GET", "/api/cameras/top/stream") as answer:
        assert answer.headers["content-type"].startswith("multipart/x-mixed-replace; boundary=")
        assert "content-encoding" not in answer.headers
        received = b""
        for part in answer.iter_raw():
            received += part
            if received.count(b"--ctr-station-picture") >= 4:
                break
        assert cameras(station)["top"]["watched"]
    heads = [part.split(b"\r\n\r\n", 1) for part in received.split(b"--ctr-station-picture\r\n")[1:4]]
    times = [float(head.split(b"x-exposed: ")[1]) for head, _ in heads]
    assert times == sorted(set(times))
    assert decoded(heads[0][1]).shape == (480, 640, 3)
    until(lambda: not cameras(station)["top"]["watched"])


@pytest.mark.parametrize("path", ["stream", "snapshot", "overlay"])
def test_unknown_camera_is_refused_with_the_known_ones(station: Served, path: str) -> None:
    answer = station.rest.get(f"/api/cameras/front/{path}")

    assert answer.status_code == 404
    assert answer.json()["error"] == "there is no camera 'front'; the cameras are: side, top, usb"


def test_snapshot_of_a_missing_camera_is_refused_with_the_reason_and_has_no_overlay(station: Served) -> None:
    answer = station.rest.get("/api/cameras/usb/snapshot")
    assert answer.status_code == 503
    assert "no such device" in answer.json()["error"]
    assert "not known" in station.rest.get("/api/cameras/usb/overlay").json()["reason"]


def test_streams_beyond_the_limit_are_refused(station: Served) -> None:
    with ExitStack() as opened:
        parts: list[Iterator[bytes]] = []
        for _ in range(8):
            answer = opened.enter_context(station.rest.stream("GET", "/api/cameras/side/stream"))
            parts.append(answer.iter_raw())  # a generator that is dropped would close its stream
            next(parts[-1])
        refused = station.rest.get("/api/cameras/side/stream")
        assert refused.status_code == 503
        assert "8 streams" in refused.json()["error"]
    until(lambda: station.rest.get("/api/cameras/side/snapshot").status_code == 200)
    until(lambda: not cameras(station)["side"]["watched"])


def test_stopped_and_killed_cameras_are_warnings_and_the_run_continues(station: Served) -> None:
    station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 600.0})
    station.wait_for(lambda status: status["state"] == "RUNNING")
    missed = station.status()["loop"]["missed"]
    processes = children(station.process.pid, "ctr-camera")
    for process in processes:
        os.kill(process.pid, signal.SIGSTOP)
    warned: set[str] = set()

    def all_have_warned(status: dict[str, Any]) -> bool:
        warned.update(name for name in ("side", "top") if status["devices"][f"camera {name}"]["severity"] == 1)
        return len(warned) == 2

    try:
        status = station.wait_for(all_have_warned)
        assert status["state"] == "RUNNING"
        ticks = status["loop"]["ticks"]
        status = station.wait_for(lambda status: status["loop"]["ticks"] > ticks + 500)
        assert status["state"] == "RUNNING"
        assert status["loop"]["missed"] - missed < 500  # the loop ran on; other programs may delay it
    finally:
        for process in processes:
            with contextlib.suppress(psutil.NoSuchProcess):  # it may have been replaced
                process.kill()
    station.wait_for(
        lambda status: (
            not any(process.is_running() for process in processes)
            and all(status["devices"][f"camera {name}"]["severity"] == 0 for name in ("side", "top"))
        )
    )
    assert station.status()["state"] == "RUNNING"
    station.post("/api/stop")


def test_desired_tip_is_in_the_overlay_during_a_run(station: Served) -> None:
    station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 600.0})
    station.wait_for(lambda status: status["state"] == "RUNNING" and status["phase"] == "moving")
    deadline = time.monotonic() + 60.0
    while (overlay := station.rest.get("/api/cameras/side/overlay").json())["tip_desired"] is None:
        assert time.monotonic() < deadline
    station.post("/api/stop")

    assert np.abs(np.subtract(overlay["tip_desired"], overlay["tip_measured"])).max() < 10.0
