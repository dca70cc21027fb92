"""Controller settings of files: selection of the model's integrator, and refused combinations."""

import pytest

from core.errors import DescriptionError
from station.config.controllers import DEFAULT_CONTROLLER, ControllerFile, Present, StagesLatency, default_controller
from station.config.robots import load_robot


@pytest.mark.parametrize(
    ("name", "integrator", "step"),
    [("paper", "paper", 0.010), ("balanced_pair", "fourth_order", 0.018), ("nylon", "fourth_order", 0.0138)],
)
def test_the_robot_selects_the_integrator_of_its_controller(name, integrator, step):
    robot = load_robot(name)
    model = ControllerFile().controller(robot).statics

    assert (model.used_integrator, model.step) == (integrator, pytest.approx(step, rel=5e-3))


def test_a_configured_integrator_is_used():
    robot = load_robot("balanced_pair").robot()
    chosen = ControllerFile(integrator="paper")

    model = chosen.model(robot)
    assert (model.used_integrator, model.step) == ("paper", 0.010)
    assert model.discretisation == "the paper's integrator, sub-links of 10 mm"


@pytest.mark.parametrize(
    ("changes", "present", "refusal"),
    [
        ({"inner": "type_1"}, Present(sensors=False), "controller.inner = 'type_1' needs force sensors.*use 'type_2'"),
        ({"strategy": "loaded_jacobian"}, Present(sensors=False), "needs force sensors.*use 'unloaded_jacobian'"),
        ({"inner": "type_2"}, Present(tracker=False), "'type_2' needs a tracker.*use 'type_1_exact'"),
        ({"feedback": "tracker"}, Present(tracker=False), "feedback = 'tracker' needs a tracker.*use 'observer'"),
        ({"inner": "type_1_exact"}, Present(tracker=False, sensors=False), "needs force sensors.*use 'unloaded'"),
    ],
)
def test_a_setting_whose_input_is_not_measured_is_refused_with_one_that_fits(changes, present, refusal):
    file = ControllerFile(**changes)
    file.check_devices(Present())

    with pytest.raises(DescriptionError, match=refusal):
        file.controller(load_robot("paper"), present)


@pytest.mark.parametrize("present", [Present(a, b) for a in (True, False) for b in (True, False)])
def test_the_default_controller_of_every_bench_uses_only_what_the_bench_measures(present):
    default_controller(present).controller(load_robot("paper"), present)
    assert default_controller(Present()) == DEFAULT_CONTROLLER


@pytest.mark.parametrize(
    ("keys", "expected"),
    [({}, (0.004, 0.003)), ({"command_interval": 0.01}, (0.01, 0.003)), ({"transport_delay": 0.0}, (0.004, 0.0))],
)
def test_keys_of_the_controller_override_the_latency_of_the_stages(keys, expected):
    built = ControllerFile(**keys).controller(load_robot("paper"), latency=StagesLatency(0.004, 0.003))
    actuation = built.estimator.actuation
    assert (actuation.command_interval, actuation.transport_delay) == expected
