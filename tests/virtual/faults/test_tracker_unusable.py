"""Tracker frames that arrive but cannot be used end a motion before the tip leaves its path by 3 mm."""

import numpy as np
import pytest

from station.control.states import State
from station.experiments.experiment import load_experiment
from tests.harness.cases import a_run
from tests.harness.virtual_station import VirtualStation, usual_case

FARTHEST_M = 3e-3


def path_error(station: VirtualStation, begin: int) -> float:
    """Return the largest distance of the true tip from its path since the row `begin` while the motion ran [m]."""
    rows = station.rows[begin:]
    away = np.linalg.norm(station.of("tip_true", rows) - station.of("tip_desired", rows), axis=1)
    return float(away[station.of("state", rows).ravel() == State.RUNNING].max())


@pytest.mark.parametrize(
    ("kind", "value", "cause"),
    [
        ("delay", 0.11, "the tracker's frames arrive 1"),
        ("noise", 1e-3, "the tracker's frames scatter by"),
        ("noise", 3e-3, "the tracker's frames scatter by"),
    ],
)
def test_a_motion_ends_if_its_frames_cannot_be_used(kind: str, value: float, cause: str) -> None:
    station = VirtualStation(usual_case()).moving(since=2.0)
    begin = len(station.rows)
    station.fail(kind, "tracker", value=value)
    took = station.becomes(State.HOLD)
    assert station.loop.cause.startswith(cause)
    assert took < 1.5
    assert path_error(station, begin) < FARTHEST_M


@pytest.mark.parametrize(
    ("kind", "value", "named"),
    [("delay", 0.05, "the tracker's frames arrive"), ("noise", 4e-4, "the tracker's frames scatter by 0.")],
)
def test_a_motion_goes_on_with_worse_frames_which_a_warning_names(kind: str, value: float, named: str) -> None:
    station = VirtualStation(usual_case()).moving(since=2.0)
    begin = len(station.rows)
    assert station.loop.warning == ""
    station.fail(kind, "tracker", value=value)
    station.seconds(8.0)
    assert station.state is State.RUNNING
    tracker = station.devices.tracker
    assert tracker is not None
    assert named in f"{station.loop.warning} {tracker.trouble(station.now)}"
    assert path_error(station, begin) < FARTHEST_M


def test_an_oscillation_of_joints_and_forces_is_not_called_noise_of_the_tracker() -> None:
    case = load_experiment("fig4", {"lab": "realistic"}, check_motions=False, only="deflection").cases[0]
    run = a_run(case, 1)
    assert run.cause.startswith("the model's tip oscillates by 0.")
    assert "use a lower controller.filter_bandwidth" in run.cause
    slow = load_experiment(
        "fig4", {"lab": "realistic", "controller": {"filter_bandwidth": 1.0}, "duration": 12.0},
        check_motions=False, only="deflection",
    ).cases[0]  # fmt: skip
    assert a_run(slow, 1).completed
