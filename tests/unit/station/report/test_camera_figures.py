"""Pictures of a camera in a report and in the player: their times, the drawing over them, and damaged videos."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from core.model.statics import Statics
from core.robot.robot import Array
from station.camera.video import VideoWriter
from station.config.robots import RobotFile
from station.control.telemetry import Channels
from station.devices.cameras import CameraFile, SimulationFile
from station.devices.projection import view_of
from station.recording.run_folder import VIDEOS_FOLDER
from station.report.camera_figures import camera_pictures, moments, overlay_at
from station.report.page import write_report
from station.report.player import videos
from station.report.run import read_run

CAMERA = CameraFile(width=160, height=120, rate=30.0, simulation=SimulationFile(noise=0.0))


@pytest.fixture
def run(make_rows: Callable[..., Array], recorded: Callable[..., Path], channels: Channels, paper: RobotFile) -> Path:
    """Return the folder of a run of 2 s whose largest error is at 1.5 s, with a video of grey levels.

    The video starts 0.2 s before the rows. The grey level of frame number n is 40 + 2 n.
    """
    rows = make_rows(1000)
    for group in ("tip_desired", "tip_true"):
        channels.of(rows, group)[:] = (0.02, -0.03, 0.19)
    channels.of(rows, "tip_true")[750] += 0.005
    channels.of(rows, "force_variance")[:] = 1e-6
    channels.of(rows, "target_followed")[:] = 0.0
    folder = recorded(rows, "run", robot=paper.model_dump(mode="json")).parent
    (case,) = read_run(folder).cases
    writer = VideoWriter(folder / VIDEOS_FOLDER / "side.mcap", "side", CAMERA, case.start)
    for number in range(66):
        writer.write(np.full((120, 160, 3), 40 + 2 * number, np.uint8), number / 30.0 - 0.2)
    writer.close()
    return folder


def test_a_report_shows_start_largest_error_and_end(run: Path) -> None:
    found = read_run(run)
    assert [one.name for one in moments(found.cases[0])] == ["start", "largest error", "end"]
    assert moments(found.cases[0])[1].time == pytest.approx(1.5)

    (figure,) = camera_pictures(found, "test", run)
    assert "Simulated camera" in figure
    assert (run / "camera_side.png").is_file()
    assert "Camera side" in write_report(run).read_text()


def test_the_drawing_over_a_picture_is_at_the_recorded_tips(run: Path, paper: RobotFile) -> None:
    (case,) = read_run(run).cases
    view = view_of(CAMERA)
    assert view is not None
    at = overlay_at(case, view, 1.0)

    assert np.allclose(at.desired, view.project(np.array([[0.02, -0.03, 0.19]]))[0], atol=0.01)
    assert len(at.tubes) == 2
    tip = Statics(paper.robot()).solve(np.array([0.3, np.pi / 2, -0.1]), np.array([0.2, 0.0, 0.1, 0, 0, 0])).tip
    assert np.allclose(at.tubes[0][-1], view.project(tip[None])[0], atol=0.05)


def test_the_player_has_the_video_with_its_start_relative_to_the_motion(run: Path) -> None:
    (video,) = videos(read_run(run))
    assert video["start"] == pytest.approx(-0.2, abs=1e-3)
    assert json.dumps(video["view"]["matrix"])
    assert video["problem"] == ""


def test_a_damaged_video_is_a_sentence_in_report_and_player(run: Path) -> None:
    (run / VIDEOS_FOLDER / "side.mcap").write_bytes(b"no video")
    (sentence,) = camera_pictures(read_run(run), "test", None)
    assert "Camera &#x27;side&#x27; has no pictures" in sentence
    assert "damaged" in videos(read_run(run))[0]["problem"]
