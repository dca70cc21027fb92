"""Estimation of contacts on the shaft from telemetry, and detection of a load on the shaft in virtual runs."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from core.model.statics import Statics
from core.robot.robot import Array
from station.config.robots import load_robot
from station.control.states import State
from station.control.telemetry import Channels
from station.experiments.experiment import load_experiment
from station.experiments.runner import Recording
from station.service.contact import AGREEING_WINDOWS, WINDOW_ROWS, ContactMonitor, estimate_contact
from tests.harness.cases import a_run

#: Experiment in which the joints stay, except for a rotation by a hundredth of a degree.
RESTING = """
title = "resting"
start = {{ outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }}
duration = 2.0
settling = 0.0
[trajectory]
kind = "joint_sweep"
joint = "outer_rotation"
speed = 0.0001
distance = 0.0001
[load]
{load}
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Callable[[str], Recording]:
    """Return a function that runs the experiment under a load, given as TOML, once for each load."""

    @cache
    def recorded(load: str) -> Recording:
        path = tmp_path_factory.mktemp("resting") / "own.toml"
        path.write_text(RESTING.format(load=load), encoding="utf-8")
        return a_run(load_experiment(str(path)).cases[0])

    return recorded


@pytest.mark.parametrize("place", [0.06, 0.10])
def test_contact_on_the_shaft_is_distinguished_from_a_load_at_the_tip_and_located(recorded, place):
    run = recorded(f'kind = "contact"\nmagnitude = 0.3\nplace = {place:g}\ndirection = [0.0, 1.0, 0.3]')

    touch = estimate_contact(Statics(load_robot("paper").robot()), run.channels, run.rows[-300:])

    assert touch is not None
    assert not touch.tip.accepted
    assert touch.contact is not None
    assert touch.contact.arc_length == pytest.approx(place, abs=10e-3)
    assert any(start - 1e-3 <= place <= end + 1e-3 for start, end in touch.contact.intervals)
    np.testing.assert_allclose(np.linalg.norm(touch.force), 0.3, atol=0.02)


def test_weight_at_the_tip_is_not_reported_as_a_contact_on_the_shaft(recorded):
    run = recorded('kind = "constant"\nmagnitude = 0.3')

    touch = estimate_contact(Statics(load_robot("paper").robot()), run.channels, run.rows[-300:])

    assert touch is not None
    assert touch.tip.accepted
    assert touch.contact is None


def drifted(run: Recording) -> np.ndarray:
    """Return the last rows of a run, as if a sensor 0.1 m behind the plate had drifted by 30 mN on each axis."""
    rows, more = run.rows[-300:].copy(), np.array([0.03, -0.03, 0.03])
    run.channels.of(rows, "force")[:] += more
    run.channels.of(rows, "moment")[:] += np.cross([0.0, 0.0, -0.1], more)
    return rows


def test_sensor_drift_widens_the_interval_of_a_contact_and_does_not_invent_one(recorded):
    statics = Statics(load_robot("paper").robot())
    weight = recorded('kind = "constant"\nmagnitude = 0.3')
    assert estimate_contact(statics, weight.channels, drifted(weight)).contact is None

    leaning = recorded('kind = "contact"\nmagnitude = 0.3\nplace = 0.1\ndirection = [0.0, 1.0, 0.3]')
    sharp, blunt = (
        estimate_contact(statics, leaning.channels, rows).contact for rows in (leaning.rows[-300:], drifted(leaning))
    )
    (first, last), (low, high) = sharp.intervals[0], blunt.intervals[0]
    assert high - low > 1.5 * (last - first)
    assert low <= 0.1 <= high


def test_note_about_moments_that_fit_no_contact_names_drift_as_a_cause(recorded):
    leaning = recorded('kind = "contact"\nmagnitude = 0.3\nplace = 0.1\ndirection = [0.0, 1.0, 0.3]')
    rows = leaning.rows[-300:].copy()
    leaning.channels.of(rows, "moment")[:] += [0.0, 0.00383, 0.00115]  # along the force, which cannot cause it
    touch = estimate_contact(Statics(load_robot("paper").robot()), leaning.channels, rows).contact
    assert not touch.located
    assert "tare again" in touch.note
    assert "along the shaft" not in touch.note


def test_too_few_rows_give_no_contact_report(recorded):
    run = recorded('kind = "none"')

    assert estimate_contact(Statics(load_robot("paper").robot()), run.channels, run.rows[:5]) is None


SIX = """
title = "resting"
robot = "balanced_pair"
lab = "pointing"
start = {{ outer_rotation = 0.0, middle_rotation = 1.5707963267948966, inner_rotation = 4.15, outer_translation = -0.026, middle_translation = -0.083, inner_translation = -0.155 }}
duration = 2.0
settling = 0.0
[trajectory]
kind = "joint_sweep"
joint = "inner_rotation"
speed = 0.0001
distance = 0.0001
[load]
kind = "contact"
magnitude = 0.3
place = {place:g}
direction = [0.0, 1.0, 0.3]
"""  # noqa: E501


@pytest.mark.parametrize("place", [0.10, 0.22])
def test_contact_on_a_robot_of_three_tubes_is_located_by_three_sensors(tmp_path, place):
    """The contact is on the overlapping tubes, or on the innermost tube beyond them."""
    path = tmp_path / "own.toml"
    path.write_text(SIX.format(place=place), encoding="utf-8")
    run = a_run(load_experiment(str(path)).cases[0])

    touch = estimate_contact(Statics(load_robot("balanced_pair").robot()), run.channels, run.rows[-300:])

    assert touch is not None
    assert not touch.tip.accepted
    assert touch.contact is not None
    assert touch.contact.located, touch.contact.note
    assert touch.contact.arc_length == pytest.approx(place, abs=10e-3)
    assert any(start - 1e-3 <= place <= end + 1e-3 for start, end in touch.contact.intervals)
    np.testing.assert_allclose(np.linalg.norm(touch.force), 0.3, atol=0.02)


RUN = """
title = "touched"
start = {{ outer_rotation = 0.0, inner_rotation = 1.5707963267948966, inner_translation = -0.100 }}
duration = 3.0
settling = 0.0
[trajectory]
kind = "joint_sweep"
joint = "outer_rotation"
speed = 0.01
distance = 0.03
[load]
{load}
"""
AT_100_MM = 'kind = "contact"\nmagnitude = 0.3\nplace = 0.1\ndirection = [0.0, 1.0, 0.3]'


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Recording]:
    """Return a function that records a slowly turning joint under a load, which is given as a TOML table."""

    @cache
    def ran(load: str) -> Recording:
        path = tmp_path_factory.mktemp("touched") / "own.toml"
        path.write_text(RUN.format(load=load), encoding="utf-8")
        return a_run(load_experiment(str(path)).cases[0])

    return ran


@pytest.fixture(scope="module")
def touched(recorded: Callable[[str], Recording]) -> Recording:
    return recorded(AT_100_MM)


@pytest.fixture
def monitor() -> ContactMonitor:
    robot = load_robot("paper").robot()
    return ContactMonitor(robot, Statics(robot), Channels(robot))


def newest(run: Recording) -> Array:
    return run.rows[-WINDOW_ROWS:].copy()


def look(monitor: ContactMonitor, rows: Array, times: int = AGREEING_WINDOWS) -> None:
    for _ in range(times):
        monitor.update(rows)


def test_a_contact_is_reported_and_withdrawn_after_consecutive_agreeing_evaluations(
    monitor: ContactMonitor, touched: Recording, recorded: Callable[[str], Recording]
) -> None:
    look(monitor, newest(touched), AGREEING_WINDOWS - 1)
    assert monitor.side_load is None
    monitor.update(newest(touched))
    assert monitor.side_load is not None
    assert monitor.side_load.contact.arc_length == pytest.approx(0.1, abs=10e-3)
    assert np.linalg.norm(monitor.side_load.force) == pytest.approx(0.3, abs=0.03)
    first, last = monitor.side_load.contact.intervals[0]
    where = f"{1e3 * monitor.side_load.contact.arc_length:.0f} mm ({1e3 * first:.0f}-{1e3 * last:.0f}) from the plate"
    assert monitor.side_load.warning.startswith(f"the load does not act at the tip: contact at {where}; ")
    free = newest(recorded('kind = "none"'))
    look(monitor, free, AGREEING_WINDOWS - 1)
    assert monitor.side_load is not None
    monitor.update(free)
    assert monitor.side_load is None
    look(monitor, newest(touched))
    assert monitor.side_load is not None
    monitor.update(newest(touched)[:0])  # telemetry stops
    assert monitor.side_load is None


@pytest.mark.parametrize(
    "load",
    [
        'kind = "none"',
        'kind = "constant"\nmagnitude = 0.1\ndirection = [0.0, 1.0, 0.0]',
        'kind = "hung_weight"\nweight = 0.3\nlowering = 0.1',
    ],
)
def test_a_load_at_the_tip_is_never_reported_as_a_contact(
    monitor: ContactMonitor, ran: Callable[[str], Recording], load: str
) -> None:
    run = ran(load)
    for end in range(WINDOW_ROWS, len(run.rows), 167):  # the contact is estimated three times per second
        monitor.update(run.rows[end - WINDOW_ROWS : end])
        assert monitor.side_load is None, end


def test_no_contact_is_reported_during_fast_motion_or_missing_measurements(
    monitor: ContactMonitor, touched: Recording
) -> None:
    of = touched.channels.of
    fast, homing, blind = newest(touched), newest(touched), newest(touched)
    of(fast, "joints")[:, 1] += np.linspace(0.0, np.deg2rad(6.0), WINDOW_ROWS)
    of(homing, "state")[:] = State.HOMING
    of(blind, "trouble")[-1, 2] = 2.0
    for rows in (fast, homing, blind, newest(touched)[: WINDOW_ROWS // 2]):
        look(monitor, rows, 2 * AGREEING_WINDOWS)
        assert monitor.side_load is None
