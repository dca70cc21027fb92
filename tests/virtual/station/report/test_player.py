"""Data of the player: frames that agree with the recording and with the model."""

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
from station.report.player import CENTRE_LINE_POINTS, UNKNOWN_CODE, write_player
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
    positions = np.frombuffer(base64.b64decode(case["packed_positions"]), "<i2").reshape(case["frames"], -1)
    others = np.frombuffer(base64.b64decode(case["packed_others"]), "<f4").reshape(case["frames"], -1)
    return positions, others


def test_the_player_is_one_self_contained_file(page):
    text = page.read_text(encoding="utf-8")

    assert not re.findall(r"https?:|src=|href=|@import|url\(|{{|}}", text)
    assert "short &lt;b&gt;run&lt;/b&gt; &amp; more" in text
    assert text.count("</script>") == 2  # no text of the run ends the script


def test_the_player_has_25_frames_a_second_with_time_force_and_joints(case, short_run):
    recording = read_case(short_run / "one.mcap")
    _, others = frames(case)
    rows = np.searchsorted(recording.of("time")[:, 0], np.arange(case["frames"]) / 25.0 - 1e-9)

    assert case["frames"] == 38
    assert np.diff(others[:, 0]) == pytest.approx(0.04, abs=1e-5)
    assert others[:, 1:4] == pytest.approx(recording.of("force_filtered")[rows], abs=1e-6)
    assert others[:, 4:] == pytest.approx(recording.of("joints")[rows], abs=1e-6)
    assert case["joints"] == [["outer_rotation", "rad"], ["inner_rotation", "rad"], ["inner_translation", "m"]]


def test_the_players_tips_match_the_recording_within_the_scale(case, short_run):
    recording = read_case(short_run / "one.mcap")
    positions, others = frames(case)
    rows = np.searchsorted(recording.of("time")[:, 0], others[:, 0] - 1e-6)

    assert case["scale"] < 1e-5
    for number, group in enumerate(("tip_desired", "tip_measured", "tip_estimated", "tip_true")):
        first = 3 + 3 * CENTRE_LINE_POINTS + 3 * number
        tips = case["scale"] * positions[:, first : first + 3]
        assert tips == pytest.approx(recording.of(group)[rows], abs=case["scale"])


def test_the_players_tubes_are_the_models_shape_under_the_recorded_force(case):
    positions, others = frames(case)
    statics = Statics(load_robot("paper").robot())
    for frame in (0, 20, 37):
        force = np.append(others[frame, 1:4].astype(float), np.zeros(3))
        shape = statics.shape(statics.solve(others[frame, 4:].astype(float), force))
        line = case["scale"] * positions[frame].astype(float)
        assert line[0] == pytest.approx(0.203, abs=1e-3)  # 0.303 m of inner tube, which starts 0.1 m behind the plate
        assert line[1:3] == pytest.approx([-0.1, 0.0], abs=2e-3)  # proximal ends of inner and outer tube
        points = line[3 : 3 + 3 * CENTRE_LINE_POINTS].reshape(-1, 3)
        assert points[0] == pytest.approx([0.0, 0.0, 0.0], abs=2e-5)
        assert points[-1] == pytest.approx(shape[-1, 10:13], abs=2e-5)
        middle = np.array([np.interp(shape[-1, 0] / 31 * 16, shape[:, 0], shape[:, 10 + axis]) for axis in range(3)])
        assert points[16] == pytest.approx(middle, abs=2e-5)


def test_player_frames_without_a_model_solution_are_marked_as_unknown(synthetic_case):
    robot = {"robot": load_robot("paper").model_dump(mode="json")}
    # The inner tube is 303 mm long, so it cannot start 500 mm behind the plate: the model has no solution.
    joints = np.tile([0.0, 1.57, -0.1], (40, 1))
    joints[20:, 2] = -0.5
    case = replace(synthetic_case(joints=joints, tip_measured=np.full((40, 3), 0.01)), metadata=robot)
    positions, _ = frames(player._case_data(case, lambda _: None))

    assert (positions[:45, 0] != UNKNOWN_CODE).all()
    assert (positions[55:, : 3 + 3 * CENTRE_LINE_POINTS] == UNKNOWN_CODE).all()
    assert (positions[:, -9:-6] != UNKNOWN_CODE).all()


def test_the_player_of_a_long_run_has_a_lower_frame_rate_and_reports_its_progress(short_run, tmp_path, monkeypatch):
    monkeypatch.setattr(player, "MAX_FRAMES", 10)
    reported: list[float] = []
    case = data_of(write_player(short_run, tmp_path / "few.html", reported.append))["cases"][0]

    assert case["frames"] == 11
    assert reported == sorted(reported)
    assert reported[0] == 0.0
    assert 0.5 <= reported[-1] < 1.0


def test_a_run_without_rows_is_refused_by_the_player(folder_of):
    with pytest.raises(NoRun, match="the run has no recorded rows to play"):
        write_player(folder_of({"experiment": "fig7", "cases": {}}))


def test_an_unwritable_player_file_is_named(short_run, tmp_path):
    with pytest.raises(ReportError, match="cannot write the player"):
        write_player(short_run, tmp_path / "missing" / "own.html")
