"""The procedure `latency` on the wire-level devices."""

import math

import numpy as np
import pytest

from station.calibration import commission
from station.calibration.headless import run_headless
from station.calibration.plan import PlanSubject
from station.config.robots import load_robot
from station.control.clock import VirtualClock
from station.lab.config import HiddenConfig, LabConfig

START = np.array([0.0, math.pi / 2, -0.100])


@pytest.fixture
def subject() -> PlanSubject:
    return PlanSubject.of(load_robot("paper"), START)


def test_procedure_latency_finds_the_unknown_latency_of_the_tracker(subject):
    labs = [LabConfig(hidden=HiddenConfig(tracker_latency=late)) for late in (0.0, 0.020)]

    found = [
        run_headless(commission.latency(subject), subject, lab, 0, VirtualClock(), lambda done, text: None).latency
        for lab in labs
    ]

    # Both results contain the delay of the stages, so the difference is the added latency of the tracker.
    assert found[1].latency - found[0].latency == pytest.approx(0.020, abs=4.0 * found[1].error)
    assert found[1].error < 2e-3
