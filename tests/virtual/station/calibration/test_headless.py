"""Calibration procedures in the virtual lab, run through the control loop and the wire-level devices."""

import math

import numpy as np
import pytest

from station.calibration import procedures
from station.calibration.headless import run_headless
from station.calibration.plan import PlanSubject
from station.calibration.procedure import GoToPose, GuidedProcedure, OperatorPrompt
from station.calibration.static_lab import StaticLab
from station.config.robots import load_robot
from station.control.clock import VirtualClock
from station.lab.config import LabConfig, load_lab

START = np.array([0.0, math.pi / 2, -0.100])


@pytest.fixture(scope="module")
def subject() -> PlanSubject:
    return PlanSubject.of(load_robot("paper"), START)


def test_measurements_at_wire_level_agree_with_those_of_the_static_lab(subject):
    """Both benches have the same plant and the same hidden errors, so they differ only by noise and play."""
    lab, seen = load_lab("uncalibrated", subject.file), []

    def few(bench: PlanSubject):
        away = yield GoToPose(START + np.array([0.2, -0.15, 0.005]), 0.0, 0.0)
        back = yield GoToPose(START, 0.0, 0.3)
        yield OperatorPrompt("Hang a weight.", 0.5, 0.5)
        pulled = yield GoToPose(START, 0.5, 0.9)
        return [away, back, pulled]

    texts = []
    seen = run_headless(few(subject), subject, lab, 4, VirtualClock(), lambda done, text: texts.append((done, text)))
    still = StaticLab(subject, lab, 4)

    for measurement in seen:
        expected = still.measure(measurement.joints, measurement.weight)
        np.testing.assert_allclose(measurement.coil, expected.coil, rtol=0, atol=0.12e-3)
    pulled = seen[2].wrenches - seen[1].wrenches
    assert np.linalg.norm(pulled[:, :3].sum(axis=0)) == pytest.approx(0.5, abs=0.02)
    assert (0.5, "Hang a weight.") in texts


def test_calibration_procedure_can_be_stepped_through_and_aborted(subject):
    guided = GuidedProcedure(procedures.tracker(subject, procedures.Effort(unloaded=8)))
    still = StaticLab(subject, LabConfig(), 0)
    done = []
    while isinstance(guided.step, GoToPose) and len(done) < 3:
        done.append(guided.done)
        guided.answer(still.measure(guided.step.joints, 0.0))

    assert done == sorted(done)
    guided.abort()
    assert guided.step is None
    assert guided.result is None
