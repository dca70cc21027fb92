"""The preset `balanced_pair` does not snap anywhere in its travel, and its working pose can be reached."""

from core.robot.strength import design_snap_number
from station.config.robots import load_robot
from tests.unit.station.service import test_feasibility


def test_balanced_pair_does_not_snap_anywhere_in_its_travel():
    file = load_robot("balanced_pair")
    lower, upper = file.limits().packed[:2]
    assert 0.9 < design_snap_number(file.robot(), lower, upper) < 1.0


def test_path_of_the_balanced_pair_from_the_homed_pose_to_the_working_pose_is_accepted():
    test_feasibility.test_path_from_the_homed_pose_to_the_working_pose_is_accepted("balanced_pair")
