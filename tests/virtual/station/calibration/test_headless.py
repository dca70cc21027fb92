"""Procedures through the control loop and the wire-level devices."""

import math

import numpy as np
import pytest

from station.calibration import commission, procedures
from station.calibration.headless import carry_out
from station.calibration.plan import Subject
from station.calibration.procedure import Ask, GoTo, Guided
from station.calibration.static_lab import StaticLab
from station.config.robots import load_robot
from station.control.clock import VirtualClock
from station.lab.config import HiddenConfig, LabConfig, load_lab

START = np.array([0.0, math.pi / 2, -0.100])


@pytest.fixture(scope="module")
def subject() -> Subject:
    return Subject.of(load_robot("paper"), START)


def test_visits_on_the_wire_are_those_of_the_still_lab(subject):
    """The same true robot and the same hidden errors: the two benches differ by noise and play alone."""
    lab, seen = load_lab("uncalibrated", subject.file), []

    def few(bench: Subject):
        away = yield GoTo(START + np.array([0.2, -0.15, 0.005]), 0.0, 0.0)
        back = yield GoTo(START, 0.0, 0.3)
        yield Ask("Hang a weight.", 0.5, 0.5)
        pulled = yield GoTo(START, 0.5, 0.9)
        return [away, back, pulled]

    texts = []
    seen = carry_out(few(subject), subject, lab, 4, VirtualClock(), lambda done, text: texts.append((done, text)))
    still = StaticLab(subject, lab, 4)

    for measurement in seen:
        expected = still.measure(measurement.joints, measurement.weight)
        np.testing.assert_allclose(measurement.coil, expected.coil, rtol=0, atol=0.12e-3)
    pulled = seen[2].wrenches - seen[1].wrenches
    assert np.linalg.norm(pulled[:, :3].sum(axis=0)) == pytest.approx(0.5, abs=0.02)
    assert (0.5, "Hang a weight.") in texts


def test_latency_that_nobody_told_is_found(subject):
    labs = [LabConfig(hidden=HiddenConfig(tracker_latency=late)) for late in (0.0, 0.020)]

    found = [
        carry_out(commission.latency(subject), subject, lab, 0, VirtualClock(), lambda done, text: None).latency
        for lab in labs
    ]

    # The stages' own delay is in both.
    assert found[1].latency - found[0].latency == pytest.approx(0.020, abs=4.0 * found[1].error)
    assert found[1].error < 2e-3


def test_a_procedure_can_be_walked_through_and_given_up(subject):
    guided = Guided(procedures.tracker(subject, procedures.Effort(unloaded=8)))
    still = StaticLab(subject, LabConfig(), 0)
    done = []
    while isinstance(guided.step, GoTo) and len(done) < 3:
        done.append(guided.done)
        guided.answer(still.measure(guided.step.joints, 0.0))

    assert done == sorted(done)
    guided.abort()
    assert guided.step is None
    assert guided.result is None
