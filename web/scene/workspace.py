"""Workspace of the tip without a load: a surface around the tips of random poses within the joints' travel."""

import threading

import numpy as np

from core.model.batch import solve_many
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Indices

#: Number of solved poses, and number of poses between two checks whether the computation was cancelled.
POSE_COUNT, BATCH_POSES = 1500, 100
#: Number of cuts across the plate's axis, and number of corners of each ring of the surface.
AXIAL_CUTS, RING_CORNERS = 28, 48


def reachable_tips(
    statics: Statics, limits: Limits, poses: int = POSE_COUNT, ending: threading.Event | None = None
) -> Array:
    """Return the tips (k, 3) [m] of random unloaded poses within the joints' travel; unsolved poses are omitted."""
    lower = np.array([limit.lower for limit in limits.joints])
    upper = np.array([limit.upper for limit in limits.joints])
    joints = lower + np.random.default_rng(0).random((poses, len(lower))) * (upper - lower)
    tips = [np.empty((0, 3))]
    for batch in np.split(joints, range(BATCH_POSES, poses, BATCH_POSES)):
        if ending is not None and ending.is_set():
            break
        solved = solve_many(statics, batch, np.zeros((len(batch), 6)))
        tips.append(solved.tip[solved.ok])
    return np.concatenate(tips)


def turns_as_a_whole(limits: Limits, statics: Statics) -> bool:
    """Return whether every tube can make a whole turn, so that the workspace is symmetric about the plate's axis."""
    robot = statics.robot
    turning = {
        joint.tube
        for joint, limit in zip(robot.joints, limits.joints, strict=True)
        if joint.motion == "rotation" and limit.upper - limit.lower >= 2.0 * np.pi
    }
    return turning == set(range(len(robot.tubes)))


def hull(tips: Array) -> tuple[Array, Indices]:
    """Return corners (v, 3) [m] and triangles (f, 3) of the convex hull of tips (k, 3) [m]."""
    from scipy.spatial import ConvexHull  # imported here because the import is slow and most robots do not need it

    found = ConvexHull(tips)
    faces = found.simplices.astype(np.int64)
    one, two, three = (tips[faces[:, corner]] for corner in range(3))
    inward = np.einsum("fi,fi->f", np.cross(two - one, three - one), found.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return tips, faces


def workspace_surface(tips: Array, cuts: int = AXIAL_CUTS, corners: int = RING_CORNERS) -> tuple[Array, Indices]:
    """Return a surface of revolution about the z axis that encloses tips (k, 3) [m].

    In each cut across the axis, the surface extends from the smallest to the largest distance of a tip from the axis.

    Returns:
        Corners (v, 3) [m] and triangles (f, 3).
    """
    radius, height = np.hypot(tips[:, 0], tips[:, 1]), tips[:, 2]
    edges = np.linspace(height.min(), height.max(), cuts + 1)
    number = np.clip(np.searchsorted(edges, height, side="right") - 1, 0, cuts - 1)
    full = np.unique(number)
    inner = np.array([radius[number == k].min() for k in full])
    outer = np.array([radius[number == k].max() for k in full])
    middle = 0.5 * (edges[full] + edges[full + 1])
    middle[0], middle[-1] = edges[0], edges[-1]
    profile = np.stack((np.concatenate((outer, inner[::-1])), np.concatenate((middle, middle[::-1]))), axis=1)
    angle = 2.0 * np.pi * np.arange(corners) / corners
    rings = np.stack(
        (
            profile[:, :1] * np.cos(angle),
            profile[:, :1] * np.sin(angle),
            np.repeat(profile[:, 1:], corners, axis=1),
        ),
        axis=2,
    )
    a = np.arange(len(profile))[:, None] * corners
    b = (np.arange(len(profile))[:, None] + 1) % len(profile) * corners
    j, k = np.arange(corners), (np.arange(corners) + 1) % corners
    faces = np.stack((a + j, a + k, b + k, a + j, b + k, b + j), axis=2).reshape(-1, 3)
    return rings.reshape(-1, 3), faces


class WorkspaceMesh:
    """Workspace surface of one robot; a separate thread computes the surface after the first request."""

    def __init__(self, statics: Statics, limits: Limits) -> None:
        self._statics, self._limits = statics, limits
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._surface: tuple[Array, Indices] | None = None

    def surface(self) -> tuple[Array, Indices] | None:
        """Return corners (v, 3) [m] and triangles (f, 3), world frame; None while they are being computed."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._compute, name="workspace", daemon=True)
            self._thread.start()
        return self._surface

    def close(self) -> None:
        """Cancel the computation of the surface."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()

    def _compute(self) -> None:
        tips = reachable_tips(self._statics, self._limits, POSE_COUNT, self._ending)
        if self._ending.is_set() or len(tips) < 2 * AXIAL_CUTS:
            return
        base = self._statics.robot.base
        around, to = base.rotation, np.array(base.position)
        if turns_as_a_whole(self._limits, self._statics):
            corners, faces = workspace_surface((tips - to) @ around)
            self._surface = corners @ around.T + to, faces
        else:
            self._surface = hull(tips)
