"""Controller settings of files: selection of the model's integrator, and refusal of renamed keys."""

import pytest

from core.errors import DescriptionError
from core.model.statics import sublink_bend, suitable_integrator
from station.config.controllers import DEFAULT_CONTROLLER, ControllerFile, Present, default_controller
from station.config.robots import load_robot
from station.config.strict import ConfigError, Strict, check, read_toml


class ControlledCase(Strict):
    controller: ControllerFile


@pytest.mark.parametrize(
    ("name", "integrator", "step"),
    [("paper", "paper", 0.010), ("balanced_pair", "fourth_order", 0.030), ("nylon", "fourth_order", 0.030)],
)
def test_curvature_of_the_robot_selects_the_integrator_of_its_controller(name, integrator, step):
    robot = load_robot(name)
    model = ControllerFile().controller(robot).statics

    assert (model.integrator, model.step) == (integrator, step)
    assert (ControllerFile().model_note(robot.robot()) == "") == (integrator == "paper")


def test_shorter_sub_links_use_the_papers_integrator():
    robot = load_robot("balanced_pair").robot()

    assert sublink_bend(robot) == pytest.approx(0.1818, abs=1e-4)
    assert suitable_integrator(robot, 0.0025) == "paper"
    assert ControllerFile(sublink=0.0025).model(robot).integrator == "paper"


def test_configured_integrator_is_used_and_needs_no_note():
    robot = load_robot("balanced_pair").robot()
    chosen = ControllerFile(integrator="paper")

    assert (chosen.model(robot).integrator, chosen.model(robot).step) == ("paper", 0.010)
    assert chosen.model_note(robot) == ""


@pytest.mark.parametrize(("old", "new"), [("hold", "command_interval"), ("transport", "transport_delay")])
def test_renamed_controller_key_is_refused_with_its_new_name(write, old, new):
    path = write(f"[controller]\n{old} = 0.01\n")

    with pytest.raises(ConfigError) as refused:
        check(ControlledCase, read_toml(path), str(path))
    assert str(refused.value) == (
        f"{path}: unknown key 'controller.{old}': use 'controller.{new}', its new name (line 2)"
    )
    assert check(ControlledCase, {"controller": {new: 0.01}}, "new").controller.model_dump()[new] == 0.01


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
