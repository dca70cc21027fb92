"""The preset robots have the documented parameters, and an invalid robot file is refused by key."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.robot.robot import Base
from station.config.robots import load_robot
from station.config.strict import PRESETS, ConfigError


def test_paper_preset_has_the_tubes_of_the_papers_table_1(paper):
    inner, outer = paper.robot().tubes

    assert (inner.name, inner.bending_stiffness) == ("inner", 0.0413)
    assert (outer.name, outer.bending_stiffness) == ("outer", 0.048)
    assert [section.length for section in inner.sections] == [0.150, 0.153]
    assert [section.length for section in outer.sections] == [0.012, 0.153]
    for tube in (inner, outer):
        straight, curved = tube.sections
        assert straight.curvature == (0.0, 0.0)
        assert curved.curvature == (1.0 / 0.250, 0.0)
        assert tube.poisson_ratio == 0.30


def test_paper_preset_equals_the_robot_with_which_the_model_is_tested(paper, paper_robot):
    assert replace(paper.robot(), tubes=tuple(replace(tube, weight=0.0) for tube in paper.robot().tubes)) == paper_robot


def test_weight_of_a_tube_follows_from_density_and_cross_section(paper):
    inner, outer = (tube.weight for tube in paper.robot().tubes)
    assert inner == pytest.approx(0.1272, abs=1e-4)  # nitinol of 6450 kg/m^3 with a cross-section of 2.011 mm^2 [N/m]
    assert outer == pytest.approx(0.0791, abs=1e-4)  # nitinol with a cross-section of 1.251 mm^2 [N/m]


def test_stages_of_the_paper_preset_have_the_limits_of_the_papers_bench(paper):
    names = [limit.name for limit in paper.limits().joints]
    turn, turn_too, slide = paper.limits().joints

    assert names == ["outer_rotation", "inner_rotation", "inner_translation"]
    for limit in (turn, turn_too):
        assert (limit.unit, limit.lower, limit.upper) == ("rad", -2 * math.pi, 2 * math.pi)
        assert math.degrees(limit.speed) == pytest.approx(20.0)
        assert math.degrees(limit.acceleration) == pytest.approx(100.0)
    assert (slide.unit, slide.lower, slide.upper, slide.speed, slide.acceleration) == ("m", -0.130, -0.005, 0.020, 0.1)


def test_microsteps_of_the_paper_preset_are_those_of_the_stages_data_sheets(paper):
    turn, turn_too, slide = (joint.microstep for joint in paper.joints)

    # 3,072,000 microsteps are two turns of the T-RS60; a microstep of the T-LSR300B is 0.49609375 um.
    assert turn * 3_072_000 == pytest.approx(4.0 * math.pi, rel=1e-12)
    assert turn_too == turn
    assert slide == 0.49609375e-6


@pytest.mark.parametrize(
    ("spoil", "by", "message"),
    [
        ("bending_stiffness = 0.0413", "bending_stiffness = 0.0", "stiffness = 0.0: Input should be greater"),
        ("bending_stiffness = 0.0413", "bending_stifness = 0.0413", "unknown key 'tubes.0.bending_stifness'"),
        ("outer_diameter = 0.0020 ", "outer_diameter = 0.0022 ", "'inner' of 2.2 mm does not fit into tube 'outer'"),
        ("inner_diameter = 0.0012", "inner_diameter = 0.0030", "inner_diameter 3 mm is outside 0 ... 2 mm"),
        ('name = "outer"\n', 'name = "inner"\n', "the tubes inner, inner have the same name"),
        ('name = "outer_rotation"', 'name = "inner_rotation"', "two joints have the same name"),
        ('tube = "outer"', 'tube = "middle"', "moves tube 'middle', which is not one of inner, outer"),
        ('tube = "outer"', 'tube = "inner"', "rotation of tube 0 already has a joint"),
        ("upper = -0.005", "upper = -0.130", "inner_translation: travel -0.13 ... -0.13 m is empty"),
        ("microstep = 0.49609375e-6", "", "'joints.2.microstep' is missing"),
    ],
)  # fmt: skip
def test_invalid_robot_file_is_refused_by_key(write, robot_text, spoil, by, message):
    assert robot_text.count(spoil) >= 1
    path = write(robot_text.replace(spoil, by, 1))

    with pytest.raises(ConfigError) as refused:
        load_robot(str(path))

    assert str(refused.value).startswith(f"{path}: ")
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_stiffness_of_the_three_tubes_preset_follows_from_modulus_and_radii_of_its_source():
    file = load_robot("three_tubes")
    robot = file.robot()

    assert "10.1109/LRA.2024.3455906" in (PRESETS / "robots" / "three_tubes.toml").read_text(encoding="utf-8")
    assert "parameters.csv" in file.source
    radii = [(0.650e-3, 0.762e-3), (0.810e-3, 0.900e-3), (1.030e-3, 1.175e-3)]
    for tube, (inner, outer), length, curvature in zip(
        robot.tubes, radii, (0.463, 0.3305, 0.199), (10.0, 5.0, 7.0), strict=True
    ):
        assert tube.bending_stiffness == pytest.approx(58e9 * math.pi / 4 * (outer**4 - inner**4), rel=1e-5)
        assert (tube.outer_diameter, tube.inner_diameter) == pytest.approx((2 * outer, 2 * inner))
        assert tube.length == pytest.approx(length)
        assert (tube.sections[-1].length, tube.sections[-1].curvature) == (0.05, (curvature, 0.0))
    robot.check_pose(np.array([0.0, 0.0, 0.0, -0.1, -0.2, -0.3]))


def test_robot_file_may_have_a_base_pose_fixed_tubes_and_torsional_stiffness(write, robot_text):
    text = robot_text.replace(
        "poisson_ratio = 0.30", "torsional_stiffness = 0.03\nrotation = 0.4\ntranslation = -0.01", 1
    )
    text = "base = { position = [0, 0, 0.1], rotation_vector = [0, 1.5, 0] }\n" + text

    robot = load_robot(str(write(text))).robot()

    assert robot.base == Base((0.0, 0.0, 0.1), (0.0, 1.5, 0.0))
    assert robot.tubes[0].torsional_stiffness == 0.03
    assert (robot.tubes[0].rotation, robot.tubes[0].translation) == (0.4, -0.01)


def test_workspace_and_force_limit_become_limits_of_the_controller(robot_text, write):
    top, rest = robot_text.split("[[tubes]]", 1)
    box = "workspace = { lower = [-0.1, -0.1, 0.0], upper = [0.1, 0.1, 0.3] }\nmax_force = 0.8\n"

    limits = load_robot(str(write(f"{top}{box}[[tubes]]{rest}"))).limits()

    assert [type(limit).__name__ for limit in limits.others] == ["Workspace", "ForceLimit"]
    assert load_robot("paper").limits().others == ()


def test_balanced_pair_has_three_tubes_and_six_motors_and_an_inner_tube_that_balances_the_pair():
    robot = load_robot("balanced_pair").robot()
    assert (len(robot.tubes), len(robot.joints)) == (3, 6)
    inner, middle, outer = robot.tubes
    assert inner.bending_stiffness == pytest.approx((middle.bending_stiffness + outer.bending_stiffness) / 7.0)
