"""The experiment presets have the agreed poses, motions, loads, controllers and durations."""

import math
import re

import numpy as np
import pytest

from core.control.controllers import PositionMode, VelocityMode, loaded, type_1, type_2, unloaded
from core.control.trajectories import JointMotion, Setpoint
from station.config.strict import preset_names
from station.experiments.case_summary import case_facts
from station.experiments.experiment import Case, offered_experiment
from station.lab.config import load_lab
from tests.harness.cases import a_case

#: By name of the preset: duration [s], settling time [s] and names of the cases.
AGREED = {
    "fig3": (40.0, 0.0, ["a", "b", "c", "d", "d_feedforward"]),
    "fig4": (40.0, 0.0, ["deflection"]),
    "fig6": (120.0, 2.0, ["turn"]),
    "fig7": (60.0, 2.0, ["regulation"]),
    "fig8": (60.0, 2.0, ["regulation", "lift_and_drop", "type_1", "type_1_exact", "type_2", "regulation_distorted"]),
    "fig10": (200.0, 20.0, ["paper", "feedforward", "paper_distorted"]),
}


def desired(case: Case, time: float) -> np.ndarray:
    order = case.orders.at(time)
    assert isinstance(order, Setpoint)
    return order.position


@pytest.mark.parametrize("name", preset_names("experiments"))
def test_every_experiment_preset_passes_all_checks_starts_at_the_agreed_pose_and_has_a_summary(name):
    experiment = offered_experiment(name)

    assert experiment.name == name
    assert experiment.title
    for case in experiment.cases:
        if name == "points":
            assert (case.robot.name, len(case.start)) == ("balanced_pair", 6)
        else:
            assert case.start == pytest.approx([0.0, math.pi / 2.0, -0.100])
            assert case.robot.name == "paper"
        for fact in case_facts(case):
            assert "_" not in re.sub(r"'[^']*'", "", fact.text)  # except in names of files
            assert "{" not in fact.text
            assert "None" not in fact.text


@pytest.mark.parametrize("name", AGREED)
def test_an_experiment_preset_has_the_agreed_cases_and_duration(name):
    duration, settling, cases = AGREED[name]
    experiment = offered_experiment(name)

    assert [case.name for case in experiment.cases] == cases
    assert (experiment.cases[0].file.duration, experiment.cases[0].file.settling) == (duration, settling)


@pytest.mark.parametrize(
    ("name", "amplitude"), [("fig3", 0.015), ("fig4", 0.015), ("fig10", 0.010), ("fig7", 0.0), ("fig8", 0.0)]
)  # all these sinusoids are along z with 0.05 Hz
def test_the_tip_follows_a_sinusoid_along_z_or_holds_its_position(name, amplitude):
    for case in offered_experiment(name).cases:
        for time, z in {0.0: 0.0, 5.0: amplitude, 10.0: 0.0, 15.0: -amplitude, 25.0: amplitude}.items():
            assert desired(case, time) == pytest.approx([0.0, 0.0, z], abs=1e-12)


def test_the_fig6_preset_rotates_the_outer_tube_once_at_3_degrees_a_second():
    case = a_case("fig6", "turn")
    for time, speed in {0.0: 3.0, 119.9: 3.0, 120.1: 0.0}.items():
        order = case.orders.at(time)
        assert isinstance(order, JointMotion)
        assert np.degrees(order.velocity) == pytest.approx([speed, 0.0, 0.0])


@pytest.mark.parametrize(
    ("experiment", "case", "by_time"),
    [
        ("fig3", "a", {0.0: 0.0, 5.0: 0.2, 15.0: -0.2, 20.0: 0.0}),
        ("fig4", "deflection", {0.0: 0.0, 5.0: 0.2, 15.0: -0.2}),
        ("fig6", "turn", {0.0: 0.5, 119.0: 0.5}),
        ("fig7", "regulation", {0.0: 0.0, 5.0: 0.25, 10.0: 0.5, 20.0: 0.0, 30.0: 0.5}),
        ("fig8", "regulation", {0.0: 0.0, 5.0: 0.25, 10.0: 0.5, 20.0: 0.0}),
        ("fig10", "paper", {0.0: 0.0, 5.0: 0.25, 10.0: 0.5, 20.0: 0.0, 190.0: 0.5}),
    ],
)
def test_the_loads_of_the_experiment_presets_act_along_gravity_as_agreed(experiment, case, by_time):
    load = a_case(experiment, case).file.load
    for time, force in by_time.items():
        assert load.force(time) == pytest.approx([force, 0.0, 0.0], abs=1e-12)


def test_the_lift_and_drop_case_applies_and_removes_half_a_newton_in_2_5_seconds_each():
    case = a_case("fig8", "lift_and_drop")
    force = np.array([case.file.load.force(time)[0] for time in np.arange(0.0, case.file.duration, 0.1)])
    rising, falling = np.flatnonzero(np.diff(force) > 1e-9), np.flatnonzero(np.diff(force) < -1e-9)

    assert force.max() == pytest.approx(0.5)
    assert force[0] == force[-1] == 0.0
    assert len(rising) == len(falling) == 25
    assert rising[-1] < falling[0]


def test_the_simulations_of_the_paper_use_and_name_the_nominal_rod_and_ideal_devices():
    for name in ("fig3", "fig4"):
        for case in offered_experiment(name).cases:
            plant = case.lab.plant
            assert "ideal" in case.lab.title
            assert (dict(plant.tubes), dict(plant.play), plant.vary) == ({}, {}, 0.0)
            assert plant.poisson_ratio == "described"
            assert (plant.friction_force, plant.friction_moment) == (0.0, 0.0)
            assert case.lab.devices == "ideal"


def test_the_experiments_of_the_paper_differ_from_the_default_lab_only_in_the_tracker_near_metal():
    default = offered_experiment("fig8").cases[0].lab
    assert default == load_lab("gentle", offered_experiment("fig8").cases[0].robot)
    bent = default.tracker.model_copy(update={"distortion": 0.48e-3})
    for name in ("fig6", "fig7", "fig8", "fig10"):
        for case in offered_experiment(name).cases:
            distorted = case.name.endswith("_distorted")
            assert case.lab.plant == default.plant
            assert case.lab.sensors == default.sensors
            assert case.lab.tracker == (bent if distorted else default.tracker)
            assert (case.lab.title == default.title) is not distorted


@pytest.mark.parametrize(
    ("experiment", "case", "outer", "inner"),
    [
        ("fig3", "a", VelocityMode(), unloaded),
        ("fig3", "b", VelocityMode(), loaded),
        ("fig3", "c", VelocityMode(), type_1),
        ("fig3", "d", PositionMode(2.5, 2.5), type_1),
        ("fig3", "d_feedforward", PositionMode(2.5, 2.5, feedforward=True), type_1),
        ("fig7", "regulation", VelocityMode(), unloaded),
        ("fig10", "paper", PositionMode(2.5, 2.5), type_1),
        ("fig10", "feedforward", PositionMode(2.5, 2.5, feedforward=True), type_2),
    ],
)
def test_a_case_of_a_preset_uses_the_strategy_in_its_name(experiment, case, outer, inner):
    strategy = a_case(experiment, case).controller.strategy

    assert strategy.outer == outer
    assert strategy.inner is inner


def test_presets_have_the_numbers_that_the_paper_reports():
    assert offered_experiment("fig3").paper["a"].max_abs_error_mm == {"x": 7.9}
    assert offered_experiment("fig7").paper["regulation"].max_abs_error_mm == {"x": 15.5, "y": 2.3, "z": 1.1}
    assert offered_experiment("fig10").paper["paper"].max_abs_error_mm == {"x": 1.0, "z": 1.7}
    assert offered_experiment("fig6").paper["turn"].model_error_mm["loaded"] == 1.4


FASTER = ("ramp_1s", "ramp_0_5s", "ramp_0_25s", "ramp_0_1s", "step", "rubber_band", "lift_and_drop", "tap")


def test_load_rate_applies_and_removes_half_a_newton_at_every_rate_with_every_strategy():
    cases = {case.name: case for case in offered_experiment("load_rate").cases}
    strategies, loads = ("regulation", "type_1", "held"), ("ramp_10s", "ramp_1s", "ramp_0_1s", "step", "tap")

    assert len(cases) == 36
    assert {f"{strategy}-{load}" for strategy in strategies for load in loads} <= set(cases)
    for case in cases.values():
        load, duration = case.file.load, case.file.duration
        force = [load.force(time)[0] for time in np.arange(0.0, duration, 0.005)]
        assert max(force) == pytest.approx(0.5, rel=2e-3) or load.kind == "hung_weight"
        assert load.onset == 2.0
        assert load.changes[-1] + 8.0 < duration
    # Only loads that are too fast for the joints give a warning, and only with a controller that compensates loads.
    warned = {name for name, case in cases.items() if case.warnings}
    assert warned == {f"{one}-{load}" for one in strategies[:2] for load in FASTER}
