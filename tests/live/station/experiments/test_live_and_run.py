"""A live run and `ctr-station run` of the same case have the same rows, and the same errors except for noise."""

import json
from pathlib import Path
from typing import Any

import pytest

from station.client import Station
from station.control.clock import VirtualClock
from station.control.task import Phase
from station.experiments.experiment import load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case
from station.recording.read import read_case
from tests.harness.serving import Served

#: Length of the motion [s], and a load that stays until its end: without it the tip would spring back by some 10 mm.
DURATION = 4.0
LOAD = {"kind": "trapezoid", "magnitude": 0.3, "rise": 1.0}
CASE = f"""
title = "A weight that is held up"
start = {{ outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }}
duration = {DURATION}
settling = 2.0
[trajectory]
kind = "hold"
[load]
kind = "trapezoid"
magnitude = {LOAD["magnitude"]}
rise = {LOAD["rise"]}
"""
CONTROLLER = {
    "strategy": "dual_layer", "inner": "type_2", "feedback": "observer", "feedforward": True, "filter_bandwidth": 0.7,
}  # fmt: skip
#: Largest difference between the errors of both runs [mm]: noise of tracker and sensors, and delays of the live loop by
#: other programs.
NOISE = 1.0


@pytest.fixture
def headless(tmp_path: Path) -> dict[str, Any]:
    """Return the summary of the command `ctr-station run`."""
    controller = "".join(f"{key} = {json.dumps(value)}\n" for key, value in CONTROLLER.items())
    path = tmp_path / "held.toml"
    path.write_text(f"{CASE}[controller]\n{controller}[cases.held]\n", encoding="utf-8")
    (case,) = load_experiment(str(path)).cases
    return summarise(run_case(case, 0, VirtualClock(), lambda _: None))


def test_a_live_run_and_a_headless_run_have_the_same_errors(
    station: Served, headless: dict[str, Any], tmp_path: Path
) -> None:
    with Station(station.url) as client:
        run = client.start(trajectory={"kind": "hold"}, load=LOAD, controller=CONTROLLER, duration=DURATION)
        client.wait(run)
        recording = read_case(client.download(run, tmp_path / "run.mcap"))
    live = station.rest.get(f"/api/runs/{run}").json()["summary"]["cases"]["run"]

    phases = recording.of("phase")[:, 0]
    times = recording.of("time")[phases == Phase.MOVING, 0]
    assert phases[-1] == Phase.MOVING
    assert times[0] == live["motion_start"]
    assert times[-1] - times[0] < DURATION
    for key in ("true_max_abs_error_mm", "max_abs_error_mm", "true_rms_error_mm"):
        assert live[key] == pytest.approx(headless[key], abs=NOISE), key
