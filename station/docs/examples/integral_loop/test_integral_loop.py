"""The integral removes a constant error, starts at zero in each motion, and stays within its bound."""

import numpy as np
import pytest
from integral_loop import make

from core.control.controllers import PositionMode
from core.control.trajectories import Setpoint
from station.config.plugins import Setup
from station.control.clock import VirtualClock
from station.experiments.experiment import load_experiment
from station.experiments.runner import run_case

REST = Setpoint(np.zeros(3), np.zeros(3))


def loop(**options: float):
    return make(Setup(options, None, 0.002, PositionMode(2.5, 2.5)))


def test_the_velocity_is_that_of_a_proportional_and_an_integral_part():
    integral, error = loop(ki=2.0), np.array([0.0, 0.0, 1e-3])
    for _ in range(500):  # 1 s
        velocity = integral.tip_velocity(REST, -error)
    assert velocity == pytest.approx([0.0, 0.0, 2.5e-3 + 2.0 * 1e-3 * 1.0])


def test_a_new_motion_starts_without_the_integral_of_the_last_one():
    integral = loop()
    first = integral.tip_velocity(REST, np.full(3, 1e-3))
    integral.tip_velocity(REST, np.full(3, 1e-3))
    integral.reset()
    assert np.array_equal(integral.tip_velocity(REST, np.full(3, 1e-3)), first)


def test_the_integral_part_stays_within_its_bound():
    integral = loop(ki=10.0, most=0.001)
    for _ in range(5000):
        velocity = integral.tip_velocity(REST, np.full(3, -0.01))
    assert velocity == pytest.approx(np.full(3, 0.025 + 0.001))


@pytest.mark.parametrize("options", [{"ki": -1.0}, {"gain": 1.0}, {"most": 1.0}])
def test_a_wrong_key_is_refused(options: dict[str, float]):
    with pytest.raises(ValueError, match=r"ki|gain|most"):
        loop(**options)


def late_error(strategy: str, **options: float) -> float:
    """Return the mean error of the tip after 3 s under a force of 0.2 N that no inner loop compensates [mm]."""
    case = next(each for each in load_experiment("fig8").cases if each.name == "type_1")
    controller = case.file.controller.model_copy(
        update={"strategy": strategy, "inner": "unloaded", "options": {strategy: options} if options else {}}
    )
    controller = controller.controller(case.robot)
    recording = run_case(case._replace(controller=controller), 0, VirtualClock(), progress=lambda part: None)
    of, rows = recording.channels.of, recording.rows
    assert recording.completed
    return 1e3 * float(np.linalg.norm((of(rows, "tip_desired") - of(rows, "tip_true"))[1500:], axis=1).mean())


def test_a_file_selects_the_installed_loop_by_name_and_it_reduces_the_error_under_a_load():
    assert late_error("integral", ki=1.5) < 0.8 * late_error("dual_layer")
