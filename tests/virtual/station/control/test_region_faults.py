"""Meshes with faults never drive the robot: the true tip stays near its setpoint, and the tubes keep the margin."""

import numpy as np
import pytest
import trimesh

from core.robot.keep_out import KeepOut
from core.robot.regions import Region, mesh
from core.robot.robot import Array
from station.control.states import State
from tests.harness.streamed_tip import stream, with_limits
from tests.harness.true_clearance import START
from tests.tools.region_streams import random_stream

#: Setpoints in steps of 0.5 s, which end at (-2, 0, 3.5) mm.
SENT = [(0.5 * step, 1e-3 * step / 7.0 * np.array([-2.0, 0.0, 3.5])) for step in range(8)]


def boxes() -> tuple[Array, Array]:
    """Return outward triangles of a cube at 6 mm to the side of the tip, and of one at 8 mm ahead of it."""
    tip = with_limits(()).statics.solve(START, np.zeros(6)).tip
    side = np.asarray(trimesh.creation.box((0.020,) * 3).triangles) + tip + (0.016, 0.0, 0.0)
    return side, np.asarray(trimesh.creation.box((0.016,) * 3).triangles) + tip + (0.0, 0.0, 0.016)


def test_a_mesh_fault_that_was_not_found_ends_in_hold_before_the_robot_follows_it() -> None:
    """Two triangles of the box ahead are turned. Without the check of jumps the tip moves up to 28 mm by itself."""
    side, ahead = boxes()
    true = KeepOut(Region("boxes", "mesh", (), mesh=mesh(np.concatenate((side, ahead)))))
    below = np.isclose(ahead[..., 2], ahead[..., 2].min()).all(axis=1)
    ahead[below] = ahead[below][:, ::-1]
    found = stream([KeepOut(Region("boxes", "mesh", (), mesh=mesh(np.concatenate((side, ahead)))))], [true], SENT, 5.0)

    assert found.state is State.HOLD
    assert "the distance of the tubes from the region 'boxes' jumps by" in found.cause
    assert found.setpoint < 0.2e-3
    assert found.tip < 1e-3
    assert found.clearance > -0.1e-3


@pytest.mark.parametrize("seed", [7, 149])
def test_the_true_tubes_keep_the_margin_of_an_accepted_mesh(seed: int) -> None:
    """Without the region, the tubes would enter the mesh. The second one has two walls beside the same part of them."""
    found = random_stream(seed, 2.5)
    assert found is not None
    _, run, free = found
    assert run.clearance > -0.1e-3
    assert free.clearance < -2e-3
