"""A run's videos have the run's time, remain readable after a kill of camera or station, and are shown as MP4."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

from station.devices.cameras import CameraFile
from station.devices.projection import view_of
from station.recording.data_section import TELEMETRY_TOPIC
from station.recording.read import read_case
from station.recording.recover import recover
from tests.harness.camera_ball import ball_centre
from tests.harness.children import children
from tests.harness.decoded_video import decode_frames
from tests.harness.serving import Served, serving
from tests.harness.waiting import until

SETTINGS = """
[cameras.side]
simulation = { ball = 0.006, dropped = 0.05 }
"""
CIRCLE = {"trajectory": {"kind": "circle", "radius": 0.006, "period": 8.0}, "duration": 8.0}
HOLD = {"trajectory": {"kind": "hold"}, "duration": 600.0}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the data folder of the station."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "thesis.partial").mkdir()
    (folder / "thesis.partial" / "thesis.txt").write_text("the only copy", encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def running(data: Path) -> Iterator[Served]:
    with serving("--data", str(data), settings=SETTINGS, rate=1.0) as served:
        until(lambda: not served.rest.get("/api/cameras").json()[0]["problem"])
        yield served


def row_times(path: Path) -> NDArray[np.float64]:
    """Return the wall time of each telemetry row [s since 1970]."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        return np.array([one.log_time for *_, one in make_reader(file).iter_messages(topics=[TELEMETRY_TOPIC])]) / 1e9


def start(station: Served, what: dict[str, Any]) -> str:
    answer = station.post("/api/start", what)
    assert answer.status_code == 202, answer.text
    return answer.json()["run_id"]


def finished(station: Served, run: str) -> dict[str, Any]:
    station.wait_for(lambda status: status["state"] != "RUNNING" and not status["run"]["recording"])
    until(lambda: station.rest.get(f"/api/runs/{run}").json().get("videos"))
    return station.rest.get(f"/api/runs/{run}").json()


def test_video_has_the_time_of_the_telemetry_and_is_served_as_mp4(station: Served, data: Path, tmp_path: Path) -> None:
    run = start(station, CIRCLE)
    station.wait_for(lambda status: status["state"] == "RUNNING")
    details = finished(station, run)
    assert details["videos"] == ["side"]

    frames = list(decode_frames(data / run / "cameras" / "side.mcap"))
    recording, times = read_case(data / run / "run.mcap"), row_times(data / run / "run.mcap")
    tips, view = recording.of("tip_true"), view_of(CameraFile())
    assert view is not None
    inside = [(stamp / 1e9, ball_centre(picture)) for stamp, picture in frames if times[0] <= stamp / 1e9 <= times[-1]]
    assert len(inside) > 60
    stamps, found = np.array([stamp for stamp, _ in inside]), np.array([pixel for _, pixel in inside])
    pixels = view.project(tips)

    def error(offset: float) -> float:
        expected = [np.interp(stamps + offset, times, pixels[:, axis]) for axis in range(2)]
        # The colours have half of the picture's resolution, which shifts the ball by a constant part of a pixel.
        return float(np.sqrt(np.var(found - np.column_stack(expected), axis=0).sum()))

    offsets = np.arange(-0.2, 0.2, 0.002)
    best = offsets[int(np.argmin([error(offset) for offset in offsets]))]
    assert abs(best) <= 1.0 / 30.0  # at most one frame
    assert error(best) < 0.5
    answer = station.rest.get(f"/api/runs/{run}/video")
    assert answer.headers["content-type"] == "video/mp4"
    (tmp_path / "copy.mp4").write_bytes(answer.content)
    with av.open(tmp_path / "copy.mp4") as file:
        assert sum(1 for _ in file.decode(video=0)) == len(frames)
    refused = station.rest.get(f"/api/runs/{run}/video", params={"camera": "../side"})
    assert (refused.status_code, refused.json()["error"]) == (
        404, f"run '{run}' has no video '../side'; its videos are: side"
    )  # fmt: skip


def test_killed_camera_keeps_its_frames_and_the_next_process_records_on(station: Served, data: Path) -> None:
    run = start(station, HOLD)
    folder = data / f"{run}.partial" / "cameras"
    until(lambda: (folder / "side.mcap.partial").is_file() and (folder / "side.mcap.partial").stat().st_size > 40_000)
    (camera,) = children(station.process.pid, "ctr-camera")
    os.kill(camera.pid, signal.SIGKILL)
    until(lambda: (folder / "side-2.mcap.partial").is_file())
    until(lambda: (folder / "side-2.mcap.partial").stat().st_size > 40_000)
    assert station.status()["state"] == "RUNNING"
    station.post("/api/stop")
    assert finished(station, run)["label"] == "stopped"

    until(lambda: (data / run / "cameras" / "side-2.mcap").is_file())
    recover(data)  # as the next start does
    for name in ("side", "side-2"):
        assert len(list(decode_frames(data / run / "cameras" / f"{name}.mcap"))) > 10


def test_killed_station_leaves_a_whole_video(station: Served, data: Path) -> None:
    """This test is the last one of its station, which it kills."""
    run = start(station, HOLD)
    partial = data / f"{run}.partial" / "cameras" / "side.mcap.partial"
    until(lambda: partial.is_file() and partial.stat().st_size > 40_000)
    processes = psutil.Process(station.process.pid).children()
    station.process.kill()
    station.process.wait()
    psutil.wait_procs(processes, 60.0)

    until(lambda: recover(data).folders or (data / run).is_dir())
    frames = list(decode_frames(data / run / "cameras" / "side.mcap"))
    assert len(frames) > 10
    # The name of a folder of the user is like that of an unfinished run.
    assert (data / "thesis.partial" / "thesis.txt").read_text(encoding="utf-8") == "the only copy"
