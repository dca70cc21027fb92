"""What the player is given: frames that agree with the recording and with the model."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.model.statics import Statics
from station.config.robots import load_robot
from station.recording.read import read_case
from station.report import player
from station.report.page import ReportError
from station.report.player import POINTS, UNKNOWN, write_player
from station.report.run import NoRun


@pytest.fixture(scope="module")
def page(short_run, tmp_path_factory) -> Path:
    return write_player(short_run, tmp_path_factory.mktemp("player") / "own.html")


@pytest.fixture(scope="module")
def case(page) -> dict:
    return data_of(page)["cases"][0]


def data_of(page: Path) -> dict:
    text = page.read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1])


def frames(case: dict) -> tuple[np.ndarray, np.ndarray]:
    places = np.frombuffer(base64.b64decode(case["packed_places"]), "<i2").reshape(case["frames"], -1)
    others = np.frombuffer(base64.b64decode(case["packed_others"]), "<f4").reshape(case["frames"], -1)
    return places, others


def test_the_page_needs_nothing_else(page):
    text = page.read_text(encoding="utf-8")

    assert not re.findall(r"https?:|src=|href=|@import|url\(|{{|}}", text)
    assert "short &lt;b&gt;run&lt;/b&gt; &amp; more" in text


def test_there_are_25_frames_a_second_with_time_force_and_joints_of_the_recording(case, short_run):
    recording = read_case(short_run / "one.mcap")
    _, others = frames(case)
    rows = np.searchsorted(recording.of("time")[:, 0], np.arange(case["frames"]) / 25.0 - 1e-9)

    assert case["frames"] == 38
    assert np.diff(others[:, 0]) == pytest.approx(0.04, abs=1e-5)
    assert others[:, 1:4] == pytest.approx(recording.of("force_filtered")[rows], abs=1e-6)
    assert others[:, 4:] == pytest.approx(recording.of("joints")[rows], abs=1e-6)
    assert case["joints"] == [["outer_rotation", "rad"], ["inner_rotation", "rad"], ["inner_translation", "m"]]


def test_tips_are_those_of_the_recording_within_the_scale(case, short_run):
    recording = read_case(short_run / "one.mcap")
    places, others = frames(case)
    rows = np.searchsorted(recording.of("time")[:, 0], others[:, 0] - 1e-6)

    assert case["scale"] < 1e-5
    for number, group in enumerate(("tip_desired", "tip_measured", "tip_estimated", "tip_true")):
        first = 3 + 3 * POINTS + 3 * number
        tips = case["scale"] * places[:, first : first + 3]
        assert tips == pytest.approx(recording.of(group)[rows], abs=case["scale"])


def test_the_tubes_are_the_models_shape_under_the_recorded_force(case):
    places, others = frames(case)
    statics = Statics(load_robot("paper").robot())
    for frame in (0, 20, 37):
        force = np.append(others[frame, 1:4].astype(float), np.zeros(3))
        shape = statics.shape(statics.solve(others[frame, 4:].astype(float), force))
        line = case["scale"] * places[frame].astype(float)
        assert line[0] == pytest.approx(0.203, abs=1e-3)  # 0.303 m of inner tube, 0.1 m behind the plate
        assert line[1:3] == pytest.approx([-0.1, 0.0], abs=2e-3)  # where inner and outer tube begin
        points = line[3 : 3 + 3 * POINTS].reshape(-1, 3)
        assert points[0] == pytest.approx([0.0, 0.0, 0.0], abs=2e-5)
        assert points[-1] == pytest.approx(shape[-1, 10:13], abs=2e-5)
        middle = np.array([np.interp(shape[-1, 0] / 31 * 16, shape[:, 0], shape[:, 10 + axis]) for axis in range(3)])
        assert points[16] == pytest.approx(middle, abs=2e-5)


def test_where_the_model_finds_no_shape_nothing_is_made_up(made_up):
    robot = {"robot": load_robot("paper").model_dump(mode="json")}
    # the inner tube, 303 mm long, cannot begin 500 mm behind the plate
    joints = np.tile([0.0, 1.57, -0.1], (40, 1))
    joints[20:, 2] = -0.5
    case = replace(made_up(joints=joints, tip_measured=np.full((40, 3), 0.01)), metadata=robot)
    places, _ = frames(player._played(case, lambda _: None))

    assert (places[:45, 0] != UNKNOWN).all()
    assert (places[55:, : 3 + 3 * POINTS] == UNKNOWN).all()
    assert (places[:, -9:-6] != UNKNOWN).all()


def test_a_long_run_has_fewer_frames_a_second(short_run, tmp_path, monkeypatch):
    monkeypatch.setattr(player, "MOST_FRAMES", 10)
    case = data_of(write_player(short_run, tmp_path / "few.html"))["cases"][0]

    assert case["frames"] == 11


def test_progress_rises_to_the_last_case(short_run, tmp_path):
    told: list[float] = []
    write_player(short_run, tmp_path / "own.html", told.append)

    assert told == sorted(told)
    assert told[0] == 0.0
    assert 0.5 <= told[-1] < 1.0


def test_text_cannot_end_the_script(short_run, page):
    assert page.read_text(encoding="utf-8").count("</script>") == 2


def test_nothing_recorded_cannot_be_played(folder_of):
    with pytest.raises(NoRun, match="nothing was recorded that could be played"):
        write_player(folder_of({"experiment": "fig7", "cases": {}}))


def test_an_unwritable_file_is_named(short_run, tmp_path):
    with pytest.raises(ReportError, match="cannot write the player there"):
        write_player(short_run, tmp_path / "missing" / "own.html")
