"""A tracker that contradicts stages and force sensors ends a motion before the tip follows it by 3 mm.

Usual loads and paths on labs whose tubes differ from the robot's file end no motion, not even with smaller bounds.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from station.config.motions import HoldMotion
from station.control import contradiction
from station.control.states import State
from station.experiments.experiment import load_experiment
from station.lab.config import load_lab
from tests.harness.cases import a_run
from tests.harness.virtual_station import CIRCLE, VirtualStation, usual_case

FARTHEST_M = 3e-3
#: Factor by which the bounds are divided in the usual runs.
RESERVE = 1.4


def jump(size: float) -> Callable[[float, float], float]:
    return lambda time, away: size


def ramp(speed: float) -> Callable[[float, float], float]:
    return lambda time, away: speed * time


def near_metal(time: float, away: float) -> float:
    """Return an error that grows for 4 s and is small 10 mm from the place where it began [m]."""
    return 0.012 * min(1.0, 0.25 * time) * float(np.exp(-((away / 0.01) ** 2)))


def moving(lab: str, motion: Any) -> VirtualStation:
    case = usual_case()
    return VirtualStation(case._replace(lab=load_lab(lab, case.robot))).moving(motion, since=3.0)


@pytest.mark.parametrize(
    ("lab", "motion", "error", "most"),
    [
        *(("gentle", HoldMotion(), jump(size), FARTHEST_M) for size in (0.005, 0.010, 0.015, 0.025)),
        *(("gentle", HoldMotion(), ramp(speed), FARTHEST_M) for speed in (0.001, 0.003, 0.010)),
        ("gentle", HoldMotion(), near_metal, FARTHEST_M),
        *((lab, HoldMotion(), ramp(0.003), FARTHEST_M) for lab in ("realistic", "uncalibrated")),
        *(("realistic", CIRCLE, jump(size), FARTHEST_M) for size in (0.005, 0.010, 0.025)),
        # Wrong tubes explain as much on a path.
        ("gentle", CIRCLE, ramp(0.001), 7e-3),
        ("gentle", CIRCLE, ramp(0.003), 4.5e-3),
    ],
)
def test_a_displaced_tracker_ends_a_motion_before_the_tip_follows_it(lab, motion, error, most) -> None:
    station = moving(lab, motion)

    def off_path() -> np.ndarray:
        rows = station.rows[-1:]
        return (station.of("tip_true", rows) - station.of("tip_desired", rows))[0]

    begin, before, place, farthest = station.now, off_path(), station.lab.truth.tip.copy(), 0.0
    while station.state is State.RUNNING and station.now - begin < 10.0:
        away = float(np.linalg.norm(station.lab.truth.tip - place))
        station.lab.aurora.faults = replace(station.lab.aurora.faults, jump=error(station.now - begin, away))
        station.tick()
        farthest = max(farthest, float(np.linalg.norm(off_path() - before)))

    assert station.state is State.HOLD
    assert "the tracker contradicts stages and force sensors" in station.loop.cause
    assert "metal near the tracker" in station.loop.cause
    held = station.lab.truth.tip.copy()
    station.seconds(0.5)
    if motion is not CIRCLE:
        farthest += float(np.linalg.norm(station.lab.truth.tip - held))
    assert farthest < most


@pytest.mark.parametrize("gain", [0.1, 0.5, -1.0])
@pytest.mark.parametrize("sensor", [0, 1])
def test_a_force_sensor_whose_gain_changes_does_not_move_the_tip_by_3_mm(sensor: int, gain: float) -> None:
    station = moving("realistic", HoldMotion())
    begin = len(station.rows)
    station.lab.boxes[sensor].skew = gain * np.eye(6)
    station.seconds(3.0)
    away = station.of("tip_true")[begin:] - station.of("tip_desired")[begin:]
    running = station.of("state")[begin:, 0] == State.RUNNING
    assert float(np.linalg.norm(away[running], axis=1).max()) < FARTHEST_M
    assert gain == 0.1 or station.state in (State.HOLD, State.STOPPED)


@pytest.mark.parametrize("sensor", [0, 1])
@pytest.mark.parametrize("axis", [0, 1])
def test_an_offset_of_a_sensor_moves_the_tip_for_a_moment_as_a_touch_of_the_tubes_does(sensor: int, axis: int) -> None:
    station = moving("gentle", HoldMotion())
    begin, box = len(station.rows), station.lab.boxes[sensor]
    box.offset[axis] += 0.3
    station.seconds(4.0)
    away = np.linalg.norm(station.of("tip_true")[begin:] - station.of("tip_desired")[begin:], axis=1)
    assert away.max() < 5e-3
    assert away[-500:].max() < 1e-3


@pytest.mark.parametrize(
    ("experiment", "name", "lab", "seed", "duration"),
    [
        ("fig10", "feedforward", "gentle", 0, 10.0),
        ("demo", "circle", "realistic", 2, 16.0),
        ("load_rate", "regulation-tap", "realistic", 6, 5.0),
        ("load_rate", "regulation-rubber_band", "realistic", 5, 9.0),
        ("load_rate", "regulation-step", "uncalibrated", 3, 4.0),
        ("accuracy", "default-shaft", "realistic", 1, 4.0),
        ("fig8", "lift_and_drop", "uncalibrated", 3, 9.0),
    ],
)
def test_usual_loads_and_paths_contradict_nothing(experiment, name, lab, seed, duration, monkeypatch) -> None:
    for name_of in ("NOISE_DEVIATIONS", "LOADED_SHARES", "TRAVEL_SHARES"):
        monkeypatch.setattr(contradiction, name_of, getattr(contradiction, name_of) / RESERVE)
    started = contradiction.ContradictionMonitor.__init__
    monkeypatch.setattr(
        contradiction.ContradictionMonitor, "__init__", lambda self, least: started(self, least / RESERVE)
    )
    case = load_experiment(experiment, {"lab": lab}, check_motions=False, only=name).cases[0]
    run = a_run(case._replace(file=case.file.model_copy(update={"duration": duration})), seed)
    assert run.completed, run.cause
