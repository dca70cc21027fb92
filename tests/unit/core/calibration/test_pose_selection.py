"""Selected poses are inside limits, reachable and more informative than random ones."""

import numpy as np
import pytest

from core.calibration.pose_selection import (
    candidates,
    feasible,
    low_discrepancy_points,
    order_poses,
    path_is_free,
    select_poses,
)
from core.calibration.quantities import quantities
from core.errors import Unreachable
from core.model.statics import Statics
from core.robot.limits import Limits, Workspace
from station.config.robots import load_robot
from tests.harness.visited import NOISE

START = np.array([0.0, 1.5, -0.1])
REST = np.zeros(3)


def test_low_discrepancy_points_fill_the_cube_evenly():
    points = low_discrepancy_points(512, 3)

    assert ((points >= 0.0) & (points < 1.0)).all()
    counts, _ = np.histogramdd(points, bins=4, range=[(0.0, 1.0)] * 3)
    assert counts.min() >= 4  # the mean is 8; random points leave some cells with 2 or fewer


def test_candidate_poses_are_inside_all_limits(paper_robot, paper_limits):
    box = Workspace((-0.02, -1.0, 0.0), (1.0, 1.0, 0.22))
    limits = Limits(paper_limits.joints, others=(box,))
    model = Statics(paper_robot)

    found = candidates(model, limits, np.array([0.3, 0.0, 0.0]), 200)

    assert 20 < len(found) < 200
    for joints in found:
        limits.check(joints)
        tip = model.solve(joints, np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])).tip
        assert tip[0] >= -0.02
        assert tip[2] <= 0.22


def test_poses_with_nearly_flush_tube_ends_are_infeasible():
    file = load_robot("balanced_pair")
    robot, rest = file.robot(), file.working_pose
    assert rest is not None
    pose = np.array([rest[joint.name] for joint in file.joints])
    ends = robot.tube_poses(pose)[1] + np.array([tube.length for tube in robot.tubes])
    poses = np.array([pose, pose])
    for row, left in zip(poses, (1.4e-3, 1.6e-3), strict=True):
        row[3] += ends[1] - ends[2] - left  # extend the outer tube until `left` [m] before the middle tube's end

    assert feasible(Statics(robot), file.limits(), poses, REST).tolist() == [False, True]


def test_selected_poses_are_more_informative_than_random_ones(paper_robot, paper_limits):
    poses = candidates(Statics(paper_robot), paper_limits, REST, 150)
    what = quantities(paper_robot)
    chosen, information = select_poses(paper_robot, what, poses, REST, NOISE, 12)

    random = np.random.default_rng(0)
    others = [
        select_poses(paper_robot, what, poses[random.choice(len(poses), 12, replace=False)], REST, NOISE, 12)[1]
        for _ in range(5)
    ]
    assert len(set(chosen.tolist())) == 12
    assert np.linalg.slogdet(information)[1] > max(np.linalg.slogdet(other)[1] for other in others) + 1.0


def test_information_of_visited_poses_changes_the_selection(paper_robot, paper_limits):
    poses = candidates(Statics(paper_robot), paper_limits, REST, 80)
    first, known = select_poses(paper_robot, (), poses, REST, NOISE, 4)
    again, more = select_poses(paper_robot, (), poses, REST, NOISE, 4, known)

    assert first.tolist() != again.tolist()
    assert np.linalg.slogdet(more)[1] > np.linalg.slogdet(known)[1]


def test_ordered_poses_are_complete_and_their_path_is_shorter(paper_robot, paper_limits):
    model = Statics(paper_robot)
    poses = candidates(model, paper_limits, REST, 40)
    order = order_poses(model, paper_limits, START, poses, REST)

    def length(path: np.ndarray) -> float:
        return float(np.abs(np.diff(np.vstack((START, path)), axis=0) / paper_limits.speed).max(axis=1).sum())

    assert sorted(map(tuple, order)) == sorted(map(tuple, poses))
    assert length(order) < 0.6 * length(poses)


def test_a_path_through_a_forbidden_region_is_not_free(paper_robot, paper_limits):
    model = Statics(paper_robot)
    left, right = (START + np.array([turn, 0.0, 0.0]) for turn in (-1.2, 1.2))
    ends = [model.solve(joints, np.zeros(6)).tip for joints in (left, right)]
    middle = model.solve(START, np.zeros(6)).tip
    # A wall separates the tip at the path's middle from the tips at both ends of the path.
    axis = int(np.argmin([abs(ends[0][k] - ends[1][k]) for k in range(2)]))
    wall, lower, upper = 0.5 * (ends[0][axis] + middle[axis]), [-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]
    (upper if middle[axis] > wall else lower)[axis] = wall
    walled = Limits(paper_limits.joints, others=(Workspace(tuple(lower), tuple(upper)),))

    assert path_is_free(model, paper_limits, left, right, REST)
    assert feasible(model, walled, left[None], REST).all()
    assert not path_is_free(model, walled, left, right, REST)


def test_candidates_raise_unreachable_when_no_pose_is_inside_the_limits(paper_robot, paper_limits):
    nowhere = Limits(paper_limits.joints, others=(Workspace((0.5, 0.5, 0.5), (0.6, 0.6, 0.6)),))

    with pytest.raises(Unreachable, match="none of 30 poses"):
        candidates(Statics(paper_robot), nowhere, REST, 30)
