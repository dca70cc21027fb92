"""Installed loops, tasks, limits and loads are found by name and checked; a refusal states what to do."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from core.control.controllers import PositionMode
from core.control.trajectories import Setpoint
from core.control.velocity_ik import VelocityTask
from core.errors import ContractError, CtrError
from station.config.controllers import ControllerFile
from station.config.loads import InstalledLoad, force_of
from station.config.plugins import Setup, installed
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.docs.examples.integral_loop.integral_loop import IntegralLoop
from tests.harness.entry_points import install_entry_points

HERE = "tests.unit.station.config.test_plugins"
PAPER = load_robot("paper")


class Kept:
    """A task and a limit that keep what they were made from, and count their resets."""

    names = ("nothing",)

    def __init__(self, setup: Setup) -> None:
        if "bad" in setup.options:
            raise ValueError("bad is unknown")
        self.setup, self.resets = setup, 0

    def reset(self) -> None:
        self.resets += 1
        if self.setup.options.get("breaks"):
            raise OSError("no reset")

    def rows(self, at):
        return VelocityTask(np.zeros((0, len(at.joints))), np.zeros(0))

    def check(self, at) -> None: ...


class Turned:
    """An inner loop and a load that fail when they are used."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup

    def __call__(self, u_int, view):
        return VelocityTask(view.loaded.jacobian[:3], self.setup.options["share"] * u_int)

    def force(self, time: float):
        return np.array([time, 0.0, 0.0]) if time < 1.0 else None


def here(_setup: Setup):
    return lambda u_int, view: VelocityTask(view.loaded.jacobian[:3], u_int)


@pytest.fixture(autouse=True)
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    monkeypatch.syspath_prepend(str(tmp_path))
    install_entry_points(
        tmp_path,
        {
            "ctr_station.outer_loops": {"integral": "station.docs.examples.integral_loop.integral_loop:make"},
            "ctr_station.inner_loops": {
                "turned": f"{HERE}:Turned",
                "gone": "no_such_module:make",
                "here": f"{HERE}:here",
            },
            "ctr_station.tasks": {"kept": f"{HERE}:Kept", "number": "math:pi"},
            "ctr_station.limits": {"kept": f"{HERE}:Kept", "turned": f"{HERE}:Turned"},
            "ctr_station.loads": {"turned": f"{HERE}:Turned", "saw": "station.docs.examples.saw_load.saw_load:make"},
        },
    )
    return lambda groups, name: install_entry_points(tmp_path, groups, name)


def test_an_outer_loop_has_the_gains_and_its_own_keys_of_the_file():
    file = ControllerFile(strategy="integral", k1=3.0, k2=3.0, options={"integral": {"ki": 0.7}})
    outer = file.controller(PAPER).strategy.outer
    assert isinstance(outer, IntegralLoop)
    assert (outer.gain, outer.mode, outer.dt) == (0.7, PositionMode(3.0, 3.0), 0.002)


def test_an_inner_loop_a_task_and_a_limit_are_used_by_name():
    built = ControllerFile(inner="type_2", tasks=("kept",), limits=("kept",), options={"kept": {"some": 2}}).controller(
        PAPER
    )
    assert [part.setup.options for part in (*built.tasks, built.limits.others[-1])] == [{"some": 2}] * 2
    assert built.tasks[0].setup.robot.joints == built.statics.robot.joints
    turned = ControllerFile(inner="turned", options={"turned": {"share": 0.5}}).controller(PAPER)
    assert turned.strategy.inner.setup.options == {"share": 0.5}


def test_everything_with_a_state_is_reset_and_a_failed_reset_names_its_code():
    built = ControllerFile(inner="type_2", tasks=("kept",), limits=("kept",)).controller(PAPER)
    built.reset()
    assert [built.tasks[0].resets, built.limits.others[-1].resets] == [1, 1]
    outer = ControllerFile(strategy="integral").controller(PAPER).strategy
    outer.tip_velocity(Setpoint(np.ones(3), np.zeros(3)), np.zeros(3))
    outer.reset()
    assert not outer.outer.part.any()
    with pytest.raises(ContractError, match="task 'Kept': reset raised OSError: no reset"):
        replace(built, tasks=(Kept(Setup({"breaks": True})),)).reset()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            {"strategy": "integrl"},
            r"controller.strategy = 'integrl' is not one of unloaded_jacobian, .*integral; custom",
        ),
        (
            {"inner": "type_3"},
            r"controller.inner = 'type_3' is not one of type_1, .* entry point of the group ctr_station",
        ),
        (
            {"inner": "gone"},
            r"controller.inner = 'gone' \(no_such_module:make of my-bench\) cannot be loaded: ModuleNot",
        ),
        ({"inner": "here"}, "inner = 'here' .* cannot be sent to another process .* at the top of its module"),
        ({"tasks": ("number",)}, r"controller.tasks = 'number' .* is not a callable make\(setup\)"),
        ({"limits": ("turned",)}, "controller.limits = 'turned' .* made a Turned without names, rows, check"),
        ({"tasks": ("kept",), "options": {"kept": {"bad": 1}}}, "tasks = 'kept' .* raised ValueError: bad is unknown"),
        ({"strategy": "integral", "options": {"integral": {"ki": -1.0}}}, "strategy = 'integral' .*expected ki 0"),
        ({"options": {"kept": {}}}, "controller.options.kept: this controller uses no installed code of that name"),
    ],
)
def test_installed_code_that_cannot_be_used_is_refused_with_its_key_and_the_reason(keys, message):
    with pytest.raises(CtrError, match=message):
        ControllerFile(inner="type_2").model_copy(update=keys).controller(PAPER)


def test_a_name_that_two_packages_offer_is_refused(install):
    install({"ctr_station.tasks": {"kept": "math:sin"}}, "other")
    with pytest.raises(ConfigError, match=r"tasks = 'kept' is installed more than once: .* of other"):
        ControllerFile(inner="type_2", tasks=("kept",)).controller(PAPER)


def test_an_installed_load_has_its_force_and_a_wrong_one_is_refused():
    saw = InstalledLoad(name="saw", options={"peak": 0.3, "period": 2.0})
    assert force_of(saw, 1.0) == pytest.approx([0.15, 0.0, 0.0])
    assert not force_of(saw, -1.0).any()
    for table, message in (
        ({"name": "see"}, "name = 'see' is not one of saw, turned"),
        ({"name": "saw", "options": {"peak": 30.0, "period": 2.0}}, "expected a peak of 0 ... 20 N"),
        ({"name": "saw", "options": {"peaks": 0.3}}, "peaks"),
    ):
        with pytest.raises(ValueError, match=message):
            InstalledLoad.model_validate(table)
    with pytest.raises(ContractError, match="load 'turned': the force"):
        force_of(InstalledLoad(name="turned"), 2.0)


def test_installed_names_are_listed():
    assert installed("loads") == ("saw", "turned")
    assert installed("outer_loops") == ("integral",)
