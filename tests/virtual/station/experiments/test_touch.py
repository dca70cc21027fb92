"""The experiment `touch` in the virtual lab: the exact rod presses on walls and tissue with the desired force."""

from typing import Any

import numpy as np
import pytest

from core.errors import CtrError
from station.config.strict import ConfigError
from station.control.clock import VirtualClock
from station.experiments.experiment import Case, load_experiment
from station.experiments.runner import Recording, run_case

FORCE_N = 0.2


def ran(case: str, **changes: Any) -> tuple[Recording, Case]:
    chosen = load_experiment("touch", changes, only=case).cases[0]
    recording = run_case(chosen, 3, VirtualClock(), lambda _: None)
    assert recording.completed, recording.cause
    return recording, chosen


def exerted(recording: Recording, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s] and the true force of the tip along the direction [N]."""
    along = np.array(case.file.trajectory.direction, float)
    of = recording.channels.of
    return of(recording.rows, "time")[:, 0], -of(recording.rows, "force_true") @ along / np.linalg.norm(along)


def test_force_across_the_axis_does_not_oscillate_with_friction_in_the_tubes() -> None:
    recording, chosen = ran("wall", duration=12.0, lab="realistic")
    time, force = exerted(recording, chosen)
    late = force[time > 6.0]

    assert late.mean() == pytest.approx(FORCE_N, abs=0.02)
    assert late.std() < 0.02  # seeds 0 to 9: at most 0.017


@pytest.mark.parametrize("case", ["wall", "soft", "axial"])
def test_force_is_held_on_an_obstacle_at_rest(case: str) -> None:
    recording, chosen = ran(case, duration=10.0)
    time, force = exerted(recording, chosen)
    late = force[time > 6.0]

    assert late.mean() == pytest.approx(FORCE_N, abs=0.01)
    assert late.std() < 0.015
    assert force.max() < 1.5 * FORCE_N
    assert force[time < 0.3].max() < 0.01  # the tip starts 4 mm in front of it


def test_moving_wall_is_followed() -> None:
    recording, chosen = ran("moving", duration=12.0)
    time, force = exerted(recording, chosen)
    late = force[time > 4.0] - FORCE_N

    assert np.sqrt((late**2).mean()) < 0.03
    of = recording.channels.of
    travel = np.ptp(of(recording.rows, "tip_true")[time > 4.0, 0])
    assert travel == pytest.approx(0.010, abs=0.002)  # the tip moves with the wall


def test_wall_that_is_too_quick_for_the_joints_is_not_lost() -> None:
    recording, chosen = ran("fast", duration=12.0)
    time, force = exerted(recording, chosen)
    late = force[time > 4.0] - FORCE_N
    at_rest = 0.005 / (0.0308 + 0.001) / np.sqrt(2.0)  # of joints at rest, with the compliance of tubes and wall
    of = recording.channels.of
    tip = of(recording.rows, "tip_true")[time > 4.0]
    error = (tip - of(recording.rows, "tip_desired")[time > 4.0])[:, 1:]
    observed = of(recording.rows, "tip_observed")[time > 4.0]

    assert np.sqrt((late**2).mean()) < 1.1 * at_rest  # joints that lag by a quarter of a period make it larger
    assert abs(late.mean()) < 0.03
    assert np.sqrt((error**2).sum(axis=1).mean()) < 2e-3
    assert np.linalg.norm(observed - tip, axis=1).max() < 0.015  # 11 mm; an observer that loses the tip is 35 mm off


def test_tip_follows_a_circle_on_the_wall_with_friction() -> None:
    recording, chosen = ran("circle", duration=12.0)
    time, force = exerted(recording, chosen)
    of = recording.channels.of
    error = (of(recording.rows, "tip_true") - of(recording.rows, "tip_desired"))[time > 4.0, 1:]

    assert force[time > 4.0].mean() == pytest.approx(FORCE_N, abs=0.01)
    assert np.sqrt((error**2).sum(axis=1).mean()) < 1e-3


@pytest.mark.parametrize(
    ("controller", "reason"),
    [({"inner": "type_1"}, "inner = 'type_2'"), ({"stiffness": [30.0, 30.0, 300.0]}, "remove 'stiffness'")],
)
def test_controller_that_cannot_hold_a_force_is_refused(controller: dict[str, Any], reason: str) -> None:
    with pytest.raises((CtrError, ConfigError), match=reason):
        load_experiment("touch", {"controller": {"strategy": "dual_layer", **controller}}, only="wall")


@pytest.mark.parametrize("case", ["wall", "axial"])
@pytest.mark.parametrize(
    ("kind", "device"),
    [("lose_tool", "tracker"), ("mute", "sensors"), ("freeze", "sensors"), ("disconnect", "stages")],
)
def test_force_does_not_rise_when_a_device_fails_during_a_press(case: str, kind: str, device: str) -> None:
    faults = [{"kind": kind, "device": device, "at": 5.0}]
    chosen = load_experiment("touch", {"faults": faults, "duration": 8.0}, only=case).cases[0]

    recording = run_case(chosen, 3, VirtualClock(), lambda _: None)

    time, force = exerted(recording, chosen)
    assert not recording.completed
    assert time[-1] < 5.5
    assert force[time > 4.9].max() < FORCE_N + 0.05
