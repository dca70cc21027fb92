"""Detection of a load on the shaft, on rows of virtual runs."""

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
from tests.harness.cases import a_run
from web.scene.contact import AGREEING_WINDOWS, WINDOW_ROWS, ContactMonitor

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
def touched(ran: Callable[[str], Recording]) -> Recording:
    return ran(AT_100_MM)


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
    monitor: ContactMonitor, touched: Recording, ran: Callable[[str], Recording]
) -> None:
    look(monitor, newest(touched), AGREEING_WINDOWS - 1)
    assert monitor.side_load is None
    monitor.update(newest(touched))
    assert monitor.side_load is not None
    assert monitor.side_load.contact.arc_length == pytest.approx(0.1, abs=10e-3)
    assert np.linalg.norm(monitor.side_load.force) == pytest.approx(0.3, abs=0.03)
    free = newest(ran('kind = "none"'))
    look(monitor, free, AGREEING_WINDOWS - 1)
    assert monitor.side_load is not None
    monitor.update(free)
    assert monitor.side_load is None


def test_the_contact_warning_has_position_interval_and_advice(monitor: ContactMonitor, touched: Recording) -> None:
    look(monitor, newest(touched))
    assert monitor.side_load is not None
    first, last = monitor.side_load.contact.intervals[0]
    where = f"{1e3 * monitor.side_load.contact.arc_length:.0f} mm ({1e3 * first:.0f}-{1e3 * last:.0f}) from the plate"
    assert monitor.side_load.warning.startswith(f"the load does not act at the tip: contact at {where}; ")


@pytest.mark.parametrize(
    "load",
    [
        'kind = "none"',
        'kind = "constant"\nmagnitude = 0.5',
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


def test_a_contact_is_withdrawn_at_once_when_telemetry_stops(monitor: ContactMonitor, touched: Recording) -> None:
    look(monitor, newest(touched))
    assert monitor.side_load is not None
    monitor.update(newest(touched)[:0])
    assert monitor.side_load is None
