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
#: Fraction of the desired force from which the tip has contact, and largest error of the time [s].
FRACTION, ERROR_S = 0.1, 0.1


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


@pytest.mark.parametrize("case", ["wall", "axial"])
def test_force_is_held_on_an_obstacle_at_rest_and_the_start_of_contact_is_recorded(case: str) -> None:
    recording, chosen = ran(case, duration=8.0)
    time, force = exerted(recording, chosen)
    late = force[time > 6.0]
    started = recording.channels.of(recording.rows, "contact_start")[:, 0]
    touched = time[np.flatnonzero(force > FRACTION * FORCE_N)[0]]

    assert late.mean() == pytest.approx(FORCE_N, abs=0.01)
    assert late.std() < 0.015
    assert force.max() < 1.5 * FORCE_N
    assert force[time < 0.3].max() < 0.01  # the tip starts 4 mm in front of it
    if case == "wall":  # along the tubes the noise of the sensors may start a contact earlier
        assert abs(time[np.flatnonzero(started > 0.0)[0]] - touched) < ERROR_S
    later = started[time > touched + ERROR_S]  # at the start noise may interrupt the contact
    assert (later == later[0]).all()
    assert later[0] > 0.0


def test_contact_starts_again_after_the_wall_was_lost() -> None:
    """At 1 Hz and 12 mm the wall is faster than the tip, which loses it in every period."""
    recording, chosen = ran("fast", load={"amplitude": 0.012}, duration=4.0)
    time, force = exerted(recording, chosen)
    started = recording.channels.of(recording.rows, "contact_start")[:, 0]
    assert 0.05 < (force[time > 1.0] <= 0.0).mean() < 0.95  # the wall really leaves the tip
    assert len(np.unique(started[started > 0.0])) >= 3


def test_motion_without_a_desired_force_has_no_contact() -> None:
    """The load of this run is larger than the force from which a press has contact."""
    load = {"kind": "constant", "magnitude": 0.2, "direction": [-1.0, 0.0, 0.0]}
    recording, _ = ran("wall", trajectory={"kind": "hold"}, load=load, duration=1.0)
    of = recording.channels.of
    assert np.abs(of(recording.rows, "force_true")).max() > FRACTION * FORCE_N
    assert not of(recording.rows, "contact_start").any()


def test_moving_wall_is_followed() -> None:
    recording, chosen = ran("moving", duration=10.0)
    time, force = exerted(recording, chosen)
    late = force[time > 4.0] - FORCE_N

    assert np.sqrt((late**2).mean()) < 0.03
    of = recording.channels.of
    travel = np.ptp(of(recording.rows, "tip_true")[time > 4.0, 0])
    assert travel == pytest.approx(0.010, abs=0.002)  # the tip moves with the wall


def test_tip_follows_a_circle_on_the_wall_with_friction() -> None:
    recording, chosen = ran("circle", duration=9.0)
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


@pytest.mark.parametrize(
    ("case", "kind", "device"),
    [
        ("wall", "lose_tool", "tracker"),
        ("wall", "mute", "sensors"),
        ("wall", "disconnect", "stages"),
        ("axial", "freeze", "sensors"),
    ],
)
def test_force_does_not_rise_when_a_device_fails_during_a_press(case: str, kind: str, device: str) -> None:
    faults = [{"kind": kind, "device": device, "at": 3.0}]
    chosen = load_experiment("touch", {"faults": faults, "duration": 5.0}, only=case).cases[0]

    recording = run_case(chosen, 3, VirtualClock(), lambda _: None)

    time, force = exerted(recording, chosen)
    assert not recording.completed
    assert time[-1] < 3.5
    assert force[time > 2.9].max() < FORCE_N + 0.05
