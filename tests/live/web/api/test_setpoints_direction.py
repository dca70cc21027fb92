"""Leading the tip of a station that really runs, and where it points: the robot of six motors."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import connect

from station.client import Station, StationError
from station.recording.read import read_case
from tests.harness.serving import Served, serving

#: The station's clock is slow and the computer busy.
WIDE = {"silence": 2.0, "end": 20.0}
BEST = {"inner": "type_2", "feedback": "observer", "feedforward": True, "filter_bandwidth": 0.7}
POINTS = {**BEST, "task": "position_and_direction"}
TILT = 0.15  #: rad


@pytest.fixture(scope="module")
def six() -> Iterator[Served]:
    """It starts in the robot's working pose."""
    with serving(settings='robot = "balanced_pair"\nlab = "pointing"\n') as served:
        yield served


@pytest.fixture
def ready(six: Served) -> Served:
    if six.status()["state"] == "STOPPED":
        six.post("/api/reset")
    six.wait_for(lambda status: status["state"] == "READY" and not status["stale"])
    six.rest.delete("/api/operator")
    return six


def angles(ones: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Between directions (..., 3) [deg]."""
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(ones, others), axis=-1), (ones * others).sum(axis=-1)))


def test_the_true_direction_follows_the_one_that_is_told(ready: Served, tmp_path: Path) -> None:
    with Station(ready.url) as script:
        with script.setpoints(**WIDE, controller=POINTS) as tip:
            assert tip.direction is not None
            begin = np.array(tip.direction)
            across = np.cross(begin, [0.0, 0.0, 1.0])
            across /= np.linalg.norm(across)
            told = math.cos(TILT) * begin + math.sin(TILT) * np.cross(across, begin)
            answer = tip.go(0.0, 0.0, 0.0, tuple(3.0 * told))
            first = float(answer["time"])
            while answer["time"] < first + 4.0:
                answer = tip.go(0.0, 0.0, 0.0)  # the one told stands
            assert angles(np.array(answer["direction_desired"]), told) < 0.01
            assert angles(np.array(answer["direction_measured"]), told) < 3.0
            with pytest.raises(StationError, match=r"direction \[0.0, 0.0, 0.0\] has the length 0"):
                tip.go(0.0, 0.0, 0.0, (0.0, 0.0, 0.0))
        assert script.wait(tip.run)["state"] == "READY"
        recording = read_case(script.download(tip.run, tmp_path / "run.mcap"))
    times = recording.of("time")[:, 0]
    told_for = (first < times) & (times < first + 4.0)
    times, desired, true = (
        times[told_for],
        recording.of("direction_desired")[told_for],
        recording.of("direction_true")[told_for],
    )
    # Two rows are a period apart, or more where the computer made the loop wait.
    rate = np.radians(angles(desired[1:], desired[:-1])) / np.diff(times)
    assert rate.max() == pytest.approx(0.2, rel=0.01)
    settled = times > first + 2.0
    assert angles(desired, told)[settled].max() < 0.01
    assert angles(true, told)[settled].max() < 2.0
    away = np.linalg.norm(recording.of("tip_true") - recording.of("tip_desired"), axis=1)
    assert away[told_for].max() < 3e-3


def test_where_only_the_place_is_controlled_a_direction_is_refused_with_what_to_do(ready: Served) -> None:
    with Station(ready.url) as script, script.setpoints(**WIDE, controller=BEST) as tip:
        assert tip.direction is None
        with pytest.raises(StationError, match=r'begin it with controller\.task = "position_and_direction"'):
            tip.go(0.0, 0.0, 0.0, (0.0, 0.0, 1.0))
        assert "direction_desired" not in tip.go(0.0, 0.0, 0.001)


def test_an_opposite_direction_turns_it_no_faster_than_agreed_and_stop_ends_that(ready: Served) -> None:
    address = f"ws://127.0.0.1:{ready.port}/api/setpoints"
    with connect(address, proxy=None) as socket:
        socket.send(json.dumps({**WIDE, "turning": 0.05, "controller": POINTS}))
        assert "run_id" in json.loads(socket.recv())
        begun = json.loads(socket.recv())
        begin = np.array(begun["direction"])
        opposite = json.dumps({"tip": [0, 0, 0], "direction": (-begin).tolist()})
        answers = []
        for _ in range(40):
            socket.send(opposite)
            answers.append(json.loads(socket.recv()))
        assert all(answer["refused"] == "" for answer in answers)
        while answers[-1]["time"] < answers[0]["time"] + 1.0:
            socket.send(opposite)
            answers.append(json.loads(socket.recv()))
        ways = angles(np.array([answer["direction_desired"] for answer in answers]), begin)
        times = np.array([answer["time"] for answer in answers])
        assert np.isfinite(ways).all()
        assert (ways <= math.degrees(0.05) * (times - begun["time"]) + 1e-6).all()
        assert ways[-1] > 0.5 * math.degrees(0.05) * (times[-1] - times[0])
        assert ready.post("/api/stop").status_code in (200, 202)
        while "ended" not in (answer := json.loads(socket.recv())):
            pass
        assert answer["ended"] == "STOPPED"
    ready.wait_for(lambda status: status["state"] == "STOPPED")
    assert ready.post("/api/reset").status_code in (200, 202)
