"""Snap numbers, largest tip force and own weight against closed forms and the exact rod."""

import math
from dataclasses import replace

import numpy as np
import pytest

from core.errors import DescriptionError, PoseError
from core.model.statics import Statics
from core.robot.robot import Joint, Robot, Section, Tube
from core.robot.strength import LOAD_PART, design_snap_number, force_bound, own_weight, snap_number
from station.config.robots import load_robot
from station.lab.config import PlantConfig, load_lab
from station.lab.frictional_plant import FrictionalPlant

UNLOADED = np.zeros(6)
TURN = (Joint("inner", 0, "rotation"), Joint("outer", 1, "rotation"))


def pair(steepness: float, straight: float = 0.0, length: float = 0.1) -> Robot:
    """Return a robot of two tubes with the same shape: a straight proximal part, then a curve.

    Args:
        steepness: (1 + nu) u^2 L^2, for the curvature u of the curve, its length L and Poisson's ratio nu = 0.3.
        straight: length of the straight proximal part [m].
        length: length L of the curve [m].

    """
    curved = Section(length, (math.sqrt(steepness / 1.3) / length, 0.0))
    sections = (Section(straight), curved) if straight else (curved,)
    inner = Tube("inner", (*sections, Section(1e-3)), 0.02, outer_diameter=1e-3, inner_diameter=0.5e-3)
    outer = Tube("outer", sections, 0.04, outer_diameter=2e-3, inner_diameter=1.5e-3)
    return Robot("pair", (inner, outer), TURN)


class TestSnapNumber:
    def test_the_snap_number_of_the_papers_tubes_with_adjacent_curves_is_the_closed_form(self, paper_robot):
        """The snap number of two tubes whose curves start at the same arc length is l k tan(k L), here about 0.33.

        l is the mean straight length of the two tubes, weighted by the stiffness of the other tube. L is the length of
        the curves, and k^2 = (1 + nu) u^2 with the curvature u and Poisson's ratio nu.
        """
        weighted = (0.012 * 0.0413 + 0.150 * 0.048) / (0.0413 + 0.048)
        k = math.sqrt(1.3) * 4.0
        expected = weighted * k * math.tan(k * 0.153)

        found = snap_number(paper_robot, np.array([0.0, 0.0, -0.138 + 1e-9]))

        assert found == pytest.approx(expected, rel=1e-6)
        assert found == pytest.approx(0.33, abs=0.005)

    @pytest.mark.parametrize(("steepness", "straight"), [(0.3, 0.02), (1.0, 0.2), (2.4, 0.001)])
    def test_the_snap_number_of_two_tubes_matches_the_published_formula(self, steepness, straight):
        root = math.sqrt(steepness)
        expected = straight * (root / 0.1) * math.tan(root)
        assert snap_number(pair(steepness, straight), np.zeros(2)) == pytest.approx(expected, rel=1e-9)

    def test_the_snap_number_is_infinite_where_the_curves_alone_snap(self):
        below, beyond = (snap_number(pair(f * math.pi**2 / 4), np.zeros(2)) for f in (0.999, 1.001))
        assert (below, beyond) == (0.0, math.inf)

    def test_the_snap_number_is_zero_if_one_of_two_tubes_is_straight(self, one_tube):
        straight = Tube("straight", (Section(0.12),), 0.02, outer_diameter=1e-3, inner_diameter=0.5e-3)
        curved = Tube("curved", (Section(0.1, (20.0, 0.0)),), 0.02, outer_diameter=2e-3, inner_diameter=1.5e-3)
        assert snap_number(Robot("one curve", (straight, curved), TURN), np.zeros(2)) == pytest.approx(0.0, abs=1e-12)
        assert snap_number(one_tube(Section(0.1, (9.0, 1.0))), np.zeros(2)) == 0.0

    @pytest.mark.parametrize("steepness", [0.6, 0.9, 1.05, 1.4])
    def test_the_snap_number_exceeds_one_where_the_model_loses_its_margin(self, steepness):
        robot = pair(steepness, 0.06)
        opposed = Statics(robot, 0.0025).solve(np.array([math.pi, 0.0]), UNLOADED)
        snaps = snap_number(robot, np.zeros(2)) > 1.0
        # Opposed curves without twist are an equilibrium. If it is unstable, a cold start returns a twisted shape.
        twisted = np.abs(opposed.unknowns[:2]).max() > 1e-3
        assert opposed.stability > 0.0
        assert twisted == snaps

    def test_the_snap_number_of_a_design_is_the_largest_in_its_travel(self, paper_robot):
        lower, upper = np.array([-6.0, -6.0, -0.130]), np.array([6.0, 6.0, -0.005])
        translations = np.linspace(-0.130, -0.005, 30)
        largest = max(snap_number(paper_robot, np.array([0.0, 0.0, z])) for z in translations)
        assert design_snap_number(paper_robot, lower, upper) == pytest.approx(largest, rel=1e-2)
        assert largest < 0.33

    def test_a_snap_number_requires_planar_tubes_and_a_valid_pose(self, three_tubes, paper_robot):
        twisted = Tube("b", (Section(0.1, (3.0, 0.0)), Section(0.1, (0.0, 3.0))), 0.04)
        with pytest.raises(DescriptionError, match="'b' is not curved in one plane"):
            snap_number(Robot("twisted", (twisted,), ()), np.zeros(0))
        with pytest.raises(PoseError):
            snap_number(paper_robot, np.array([0.0, 0.0, 0.1]))
        with pytest.raises(DescriptionError, match="no pose within the travel"):
            design_snap_number(paper_robot, np.array([0.0, 0.0, -0.5]), np.array([0.0, 0.0, -0.4]))


class TestMargin:
    def test_the_stability_margin_of_opposed_tubes_matches_the_closed_form(self):
        for steepness in (0.5, 1.0, 2.0, 2.4):
            solution = Statics(pair(steepness), 0.001).solve(np.array([math.pi, 0.0]), UNLOADED)
            assert solution.stability == pytest.approx(math.cos(math.sqrt(steepness)), abs=1e-4)

    def test_the_stability_margin_of_a_compressed_straight_tube_vanishes_at_eulers_load(self, one_tube):
        robot, length = one_tube(Section(0.2)), 0.15
        critical = math.pi**2 * 0.04 / (4.0 * length**2)
        for part in (0.0, 0.5, 0.98):
            wrench = np.array([0.0, 0.0, -part * critical, 0.0, 0.0, 0.0])
            found = Statics(robot, 0.001).solve(np.array([0.0, -0.05]), wrench).stability
            # The margin has one factor for bending in x and one for bending in y.
            assert found == pytest.approx(math.cos(0.5 * math.pi * math.sqrt(part)) ** 2, abs=2e-3)

    def test_the_stability_margin_falls_to_zero_where_rotated_tubes_snap(self):
        """The solver follows the shape over small rotations until the branch ends; there the tubes snap."""
        model = Statics(pair(3.5), 0.005)
        near, margins, twists = None, [], []
        for angle in np.arange(0.0, 1.2 * math.pi, 0.01):
            near = model.solve(np.array([angle, 0.0]), UNLOADED, near)
            margins.append(near.stability)
            twists.append(near.unknowns[0] - near.unknowns[1])
        snap = int(np.argmax(np.abs(np.diff(twists))))

        assert math.pi < 0.01 * snap < 1.2 * math.pi
        assert np.sign(twists[snap]) != np.sign(twists[snap + 1])
        # Near the fold, where the branch ends, the square of the margin is linear in the angle. A line through the last
        # squares is zero at the fold.
        squares = np.array(margins[snap - 6 : snap + 1]) ** 2
        line = np.polyfit(0.01 * np.arange(snap - 6, snap + 1), squares, 1)
        fold = -line[1] / line[0]
        assert fold == pytest.approx(0.01 * snap, abs=0.01)
        assert min(margins) > 0.0
        assert margins[snap] < 0.25 * margins[0]
        assert margins[snap + 1] > 2.0 * margins[snap]

    def test_two_tubes_below_snap_number_one_rotate_without_a_snap(self):
        model, near, twists = Statics(pair(2.0), 0.005), None, []
        for angle in np.arange(0.0, 2.0 * math.pi, 0.02):
            near = model.solve(np.array([angle, 0.0]), UNLOADED, near)
            assert near.stability > 0.1
            twists.append(near.unknowns[0])
        assert np.abs(np.diff(twists)).max() < 2.0
        assert twists[-1] == pytest.approx(0.0, abs=0.5)


def test_the_moment_range_of_the_base_sensors_bounds_the_force_on_the_paper_s_robot(paper):
    robot, joints = paper.robot(), paper.limits().joints
    bound = force_bound(robot, joints)

    # The 0.303 m tube starts at least 5 mm behind the plate; the outer tube has 0.0480 of 0.0893 N m^2 stiffness.
    assert bound.newton == pytest.approx(LOAD_PART * 0.25 / (0.298 * 0.0480 / 0.0893))
    assert bound.reason == "the moment range of a base sensor"
    assert force_bound(robot, joints, (18.0, 0.125)).newton == pytest.approx(0.5 * bound.newton)
    assert force_bound(robot, joints, (0.1, 0.25)).reason == "the force range of a base sensor"


def test_the_strain_of_a_thick_inner_tube_bounds_the_force_before_the_sensors(paper):
    robot = paper.robot()
    inner, outer = robot.tubes
    thick = replace(robot, tubes=(replace(inner, outer_diameter=5e-3), replace(outer, inner_diameter=5e-3,
                                                                               outer_diameter=6e-3)))  # fmt: skip
    bound = force_bound(thick, paper.limits().joints)

    assert bound.reason == "the strain of tube 'inner'"
    assert bound.newton < 0.6


def test_a_robot_without_max_force_has_an_overload_bound_that_limits_no_velocity(paper):
    limits = paper.limits()
    own = paper.model_copy(update={"max_force": 0.4})

    assert limits.overload is not None
    assert limits.overload.newton == pytest.approx(0.94, abs=0.01)
    assert "force" not in str([limit.names for limit in limits.others])
    assert own.limits().overload.newton == 0.4
    assert own.largest_force().newton == 0.4


def test_the_equivalent_tip_force_of_a_single_tube_is_three_eighths_of_its_weight(one_tube):
    robot = one_tube(Section(0.2))
    heavy = replace(robot, tubes=(replace(robot.tubes[0], weight=0.3),))

    assert own_weight(heavy, np.zeros(2)) == pytest.approx(3 / 8 * 0.3 * 0.2)
    assert own_weight(robot, np.zeros(2)) == 0.0


@pytest.mark.parametrize("joints", [(0.0, 1.57, -0.1), (1.0, -0.5, -0.02), (0.5, 1.0, -0.16)])
def test_the_equivalent_tip_force_bends_the_papers_robot_like_its_weight(joints):
    """The tip error is a tenth of the sag, at most 0.05 mm; without the equivalent force it is 0.2 to 0.6 mm."""
    file, pose = load_robot("paper"), np.array(joints)
    robot = file.robot()
    rough: PlantConfig = load_lab("realistic", file).plant.model_copy(
        update={"friction": 0.0, "clearance": 0.0, "walk": 0.0, "tubes": {}, "poisson_ratio": "described", "play": {}}
    )
    tips = []
    for plant in (rough, rough.model_copy(update={"density": 0.0})):
        rod = FrictionalPlant(robot, plant, np.random.default_rng(0), pose)
        tips.append(rod.advance(pose, np.zeros(3)).truth.tip)
    sag, model = tips[0] - tips[1], Statics(robot)

    pulled = model.solve(pose, np.array([own_weight(robot, pose), 0.0, 0.0, 0.0, 0.0, 0.0])).tip
    found = pulled - model.solve(pose, np.zeros(6)).tip

    assert np.linalg.norm(found - sag) < 0.1 * np.linalg.norm(sag)


def test_force_sensor_under_the_robot_bears_the_whole_moment_of_the_load(paper):
    bound = force_bound(replace(paper.robot(), sensed="robot"), paper.limits().joints)

    # 90 % of 250 N mm, at the reach of the inner tube beyond the plate
    inner, slide = paper.tubes[0], paper.joints[2]
    reach = sum(section.length for section in inner.sections) + slide.upper
    assert bound.reason == "the moment range of a base sensor"
    assert bound.newton == pytest.approx(0.225 / reach)
