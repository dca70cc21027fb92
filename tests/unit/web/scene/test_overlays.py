"""The drawn surface of the workspace is tested with other poses than those that it was computed from."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Indices
from station.config.robots import load_robot
from tests.harness.waiting import until
from web.scene.overlays import WorkspaceMesh, hull, reachable_tips, turns_as_a_whole, workspace_surface


def ball(count: int, least: float) -> Array:
    """Return points (count, 3) between two spheres about the origin."""
    random = np.random.default_rng(1)
    points = random.normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) * random.uniform(least, 1.0, (count, 1)) ** (1 / 3)


def volume(corners: Array, faces: Indices) -> float:
    """Return the volume of a closed surface; negative if its normals point inward."""
    one, two, three = (corners[faces[:, corner]] for corner in range(3))
    return float(np.einsum("fi,fi->", one, np.cross(two, three))) / 6.0


@pytest.mark.parametrize("surface", [hull, workspace_surface])
def test_a_workspace_surface_around_a_ball_is_closed_and_its_normals_point_outward(
    surface: Callable[[Array], tuple[Array, Indices]],
) -> None:
    corners, faces = surface(ball(20000, 0.0))
    assert volume(corners, faces) == pytest.approx(4.0 / 3.0 * np.pi, rel=0.06)
    edges = [(int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)]
    assert sorted(edges) == sorted((b, a) for a, b in edges)


def test_the_workspace_surface_excludes_the_interior_of_a_shell() -> None:
    shell = ball(20000, 0.7)
    shell = shell[np.abs(shell[:, 2]) < 0.3]
    corners, faces = workspace_surface(shell)
    assert volume(corners, faces) < 0.7 * volume(*hull(shell))


def test_a_robot_without_whole_turns_has_no_workspace_surface_of_revolution() -> None:
    robot = load_robot("paper")
    statics, limits = Statics(robot.robot()), robot.limits()
    assert turns_as_a_whole(limits, statics)
    stiff = replace(limits.joints[0], lower=0.0, upper=0.5)
    assert not turns_as_a_whole(Limits((stiff, *limits.joints[1:])), statics)


def test_the_workspace_is_computed_in_a_thread_and_encloses_the_reachable_tips() -> None:
    robot = load_robot("three_tubes")
    statics, limits = Statics(robot.robot()), robot.limits()
    workspace = WorkspaceMesh(statics, limits)
    try:
        workspace.surface()
        until(lambda: workspace.surface() is not None)
        surface = workspace.surface()
        assert surface is not None
        corners, _ = surface
        again = workspace.surface()
        assert again is not None
        assert again[0] is corners
        tips = reachable_tips(statics, limits, 40)
        assert len(tips) > 10
        for axis in range(3):
            assert (tips[:, axis] <= corners[:, axis].max() + 2e-3).all()
            assert (tips[:, axis] >= corners[:, axis].min() - 2e-3).all()
    finally:
        workspace.close()


def test_closing_the_workspace_mesh_ends_its_computation() -> None:
    robot = load_robot("paper")
    workspace = WorkspaceMesh(Statics(robot.robot()), robot.limits())
    workspace.surface()
    workspace.close()
    assert workspace.surface() is None
