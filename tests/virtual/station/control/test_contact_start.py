"""The channel `contact_start` of a tip that presses: compared with the true force of the virtual lab."""

import numpy as np

from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.runner import run_case

FORCE_N = 0.2
#: Fraction of the desired force from which the tip has contact, and largest error of the time [s].
FRACTION, ERROR_S = 0.1, 0.1


def recorded(name: str, case: str, **changes: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time [s], `contact_start` [s] and true force of the tip along x [N] of a run."""
    recording = run_case(load_experiment(name, changes, only=case).cases[0], 3, VirtualClock(), lambda _: None)
    assert recording.completed, recording.cause
    of = recording.channels.of
    started = of(recording.rows, "contact_start")[:, 0]
    return of(recording.rows, "time")[:, 0], started, -of(recording.rows, "force_true")[:, 0]


def test_contact_starts_when_the_true_force_rises_and_keeps_its_time() -> None:
    time, started, force = recorded("touch", "wall", duration=4.0)
    touched = time[np.flatnonzero(force > FRACTION * FORCE_N)[0]]
    first = np.flatnonzero(started > 0.0)[0]

    assert abs(time[first] - touched) < ERROR_S
    later = started[time > touched + ERROR_S]  # at the start noise may interrupt the contact
    assert (later == later[0]).all()
    assert later[0] > 0.0


def test_contact_starts_again_after_the_wall_was_lost() -> None:
    """At 1 Hz and 12 mm the wall is faster than the tip, which loses it in every period."""
    time, started, force = recorded("touch", "fast", load={"amplitude": 0.012}, duration=5.0)
    late = time > 1.0
    free = force[late] <= 0.0
    assert 0.05 < free.mean() < 0.95  # the wall really leaves the tip
    assert len(np.unique(started[started > 0.0])) >= 3


def test_motion_without_a_desired_force_has_no_contact() -> None:
    """The load of this run is larger than the force from which a press has contact."""
    load = {"kind": "constant", "magnitude": 0.2, "direction": [-1.0, 0.0, 0.0]}
    _, started, force = recorded("touch", "wall", trajectory={"kind": "hold"}, load=load, duration=2.0)
    assert np.abs(force).max() > FRACTION * FORCE_N
    assert not started.any()
