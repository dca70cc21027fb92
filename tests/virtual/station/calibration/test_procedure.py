"""Steps of a procedure become tasks of the control loop, and their telemetry becomes measurements.

The devices are those of the wire-level lab in virtual time.
"""

from dataclasses import replace

import numpy as np
import pytest

from core.control.controller_settings import Controller
from core.control.sensors import Corrections, Sensors
from station.calibration.procedure import AbortedError, GoToPose, SwingMotion, measurement_of, task
from station.config.controllers import DEFAULT_CONTROLLER, PERIOD_S
from station.config.loads import ConstantLoad
from station.config.robots import load_robot
from station.control.loop import ControlLoop
from station.control.states import State
from station.control.task import AVERAGE_S
from station.lab.config import load_lab
from station.lab.virtual_bench import virtual_bench

START = np.array([0.0, np.pi / 2, -0.100])
AWAY = START + np.array([0.1, -0.1, 0.0])


def rows_of(
    step: GoToPose | SwingMotion, controller: Controller, paper, weight: float = 0.0
) -> tuple[ControlLoop, np.ndarray]:
    """Return the telemetry of one step from START in the lab `uncalibrated`."""
    lab, devices = virtual_bench(paper, load_lab("uncalibrated", paper), 7, START)
    if weight:
        lab.apply_load(ConstantLoad(magnitude=weight), 0.0)
    loop, rows, tick, begun = ControlLoop(controller, devices), [], 0, False
    loop.connect(0.0)
    while not (begun and loop.state is State.READY):
        row = loop.tick(tick * PERIOD_S, lab.advance(tick * PERIOD_S))
        tick += 1
        assert not loop.cause
        if begun and row is not None:
            rows.append(row)
        if not begun and loop.state is State.READY:
            loop.start(task(step, controller))
            begun = True
    return loop, np.array(rows)


@pytest.fixture(scope="module")
def at_start() -> tuple[ControlLoop, np.ndarray]:
    """Return the telemetry of a rest at START without a calibration."""
    robot = load_robot("paper")
    return rows_of(GoToPose(START, 0.0, 0.0), DEFAULT_CONTROLLER.controller(robot), robot)


def test_measurement_is_the_last_rest_with_the_arrival_direction_of_each_joint(paper):
    controller = DEFAULT_CONTROLLER.controller(paper)
    loop, rows = rows_of(GoToPose(AWAY, 0.0, 0.0), controller, paper)

    measurement = measurement_of(loop.channels, rows, GoToPose(START, 0.25, 0.0), START, controller)

    end = loop.channels.of(rows, "time")[-1, 0]
    assert measurement.time == pytest.approx(end - 0.5 * AVERAGE_S, abs=2 * PERIOD_S)
    np.testing.assert_allclose(measurement.joints, AWAY, atol=2e-3)
    assert measurement.came.tolist()[:2] == [1.0, -1.0]
    assert measurement.weight == 0.25
    assert measurement.wrenches.shape == (2, 6)


def test_coil_of_the_calibration_in_use_is_removed_from_measurements(paper):
    """If the correction stayed, the next calibration would find the coil at the tip and lose the coil's offset."""
    plain = DEFAULT_CONTROLLER.controller(paper)
    known = replace(plain, corrections=Corrections(Sensors.ideal(plain.statics.robot), np.array([2e-3, -1e-3, 3e-3])))
    step = GoToPose(START, 0.5, 0.0)
    (loop, rows), (_, corrected) = rows_of(step, plain, paper, 0.5), rows_of(step, known, paper, 0.5)

    first = measurement_of(loop.channels, rows, step, START, plain)
    second = measurement_of(loop.channels, corrected, step, START, known)

    shown = [loop.channels.of(each, "tip_measured")[-1] for each in (rows, corrected)]
    assert np.linalg.norm(shown[1] - shown[0]) == pytest.approx(np.sqrt(14.0) * 1e-3, rel=0.1)
    np.testing.assert_allclose(second.coil, first.coil, rtol=0, atol=20e-6)  # tolerance: noise of the mean position


def test_measured_coil_axis_does_not_depend_on_the_calibration_in_use(paper, at_start):
    plain, step = DEFAULT_CONTROLLER.controller(paper), GoToPose(START, 0.0, 0.0)
    axis = np.array([0.03, -0.04, np.sqrt(1.0 - 0.0025)])
    known = replace(plain, corrections=Corrections(Sensors.ideal(plain.statics.robot), axis=axis))
    (loop, rows), (_, corrected) = at_start, rows_of(step, known, paper)

    first = measurement_of(loop.channels, rows, step, START, plain)
    second = measurement_of(loop.channels, corrected, step, START, known)

    runs = [each[loop.channels.of(each, "state")[:, 0] == State.RUNNING] for each in (rows, corrected)]
    shown = [loop.channels.of(each, "direction_measured")[-1] for each in runs]
    assert np.arccos(shown[0] @ shown[1]) == pytest.approx(0.05, rel=0.05)
    assert first.axes is not None
    assert first.axes.shape == (1, 3)
    np.testing.assert_allclose(second.axes, first.axes, rtol=0, atol=2e-4)
    untold = rows.copy()
    loop.channels.of(untold, "direction_measured")[:] = 0.0
    assert measurement_of(loop.channels, untold, step, START, plain).axes is None


def test_swing_record_has_all_rows_and_frames_of_the_swing(paper):
    controller, step = DEFAULT_CONTROLLER.controller(paper), SwingMotion(np.array([0.1, 0.1, 0.003]), 4.0, 4.0, 0.0)
    loop, rows = rows_of(step, controller, paper)

    swung = measurement_of(loop.channels, rows, step, START, controller)

    assert swung.times[-1] - swung.times[0] == pytest.approx(4.0, abs=2 * PERIOD_S)
    # The joints move along (1 - cos) / 2 of the amplitudes, so they return to their start.
    np.testing.assert_allclose(np.ptp(swung.joints, axis=0), step.amplitudes, rtol=0.1)
    np.testing.assert_allclose(swung.joints[-1], swung.joints[0], atol=5e-3)
    assert 140 <= len(swung.coils) == len(swung.frame_times) <= 160
    assert (np.diff(swung.frame_times) > 0.0).all()


def test_measurement_with_too_few_rows_or_frames_is_refused(paper, at_start):
    controller, step = DEFAULT_CONTROLLER.controller(paper), GoToPose(START, 0.0, 0.0)
    loop, rows = at_start

    with pytest.raises(AbortedError, match=r"only 0\.2 of 1\.5 s were recorded"):
        measurement_of(loop.channels, rows[-102:], step, START, controller)
    with pytest.raises(AbortedError, match="were recorded"):
        measurement_of(loop.channels, rows[:0], step, START, controller)
    blind = rows.copy()
    loop.channels.of(blind, "tip_new")[:] = 0.0
    with pytest.raises(AbortedError, match="no tracker frame"):
        measurement_of(loop.channels, blind, step, START, controller)
