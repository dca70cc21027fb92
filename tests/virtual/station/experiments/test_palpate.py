"""The experiment `palpate` in the virtual lab: the estimated stiffness is close to that of the simulated tissue."""

import math
from typing import Any

import numpy as np
import pytest

from core.errors import CtrError
from station.config.strict import ConfigError
from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case


def test_lump_is_found_by_what_a_bench_has() -> None:
    row = {"columns": 2, "rows": 1, "spacing": 0.005, "travel": 3.0, "dwell": 2.0}
    case = load_experiment("palpate", {"trajectory": row, "duration": 14.0}, only="lump").cases[0]

    recording = run_case(case, 4, VirtualClock(), lambda _: None)

    assert recording.completed, recording.cause
    found = summarise(recording)
    # 150 N/m and a lump of 250 N/m, 4 mm wide, at y = 3 mm and z = -3 mm; the row is at z = 0.
    true = [150.0 + 250.0 * math.exp(-((y - 3.0) ** 2 + 9.0) / 16.0) for y in (-2.5, 2.5)]
    assert found["palpation"]["true_stiffness_N_per_m"] == [pytest.approx(true, abs=0.1)]
    assert found["palpation"]["stiffness_N_per_m"] == [pytest.approx(true, rel=0.12)]
    assert found["press"]["true_rms_error_N"] < 0.02
    for group in ("force_true", "tip_true"):
        recording.channels.of(recording.rows, group)[:] = 9.0
    assert summarise(recording)["palpation"]["stiffness_N_per_m"] == found["palpation"]["stiffness_N_per_m"]


def test_tip_that_finds_no_obstacle_gives_no_stiffness() -> None:
    changes: dict[str, Any] = {
        "trajectory": {"columns": 1, "rows": 1, "reach": 0.004, "travel": 2.0, "dwell": 2.0},
        "load": {"distance": 0.02}, "duration": 6.0,
    }  # fmt: skip
    case = load_experiment("palpate", changes, only="lump").cases[0]

    recording = run_case(case, 4, VirtualClock(), lambda _: None)

    assert recording.completed, recording.cause
    assert summarise(recording)["palpation"]["stiffness_N_per_m"] == [[None]]
    travel = recording.channels.of(recording.rows, "tip_true") @ np.array([1.0, 0.0, 0.0])
    assert travel.max() - travel[0] < 0.005  # it waits at the end of its reach of 4 mm


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"controller": {"inner": "type_1"}}, "a motion that holds a force needs strategy"),
        ({"trajectory": {"light": 0.3}}, "force 0.2 N must be greater than light 0.3 N"),
        ({"trajectory": {"across": [2.0, 0.0, 0.0]}}, "is parallel to direction"),
    ],
)
def test_palpation_that_is_impossible_is_refused(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises((CtrError, ConfigError), match=reason):
        load_experiment("palpate", changes, only="lump")
