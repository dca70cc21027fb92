"""Where the tip can go without a load: poses spread over the joints' travel, and the hull around their tips."""

import threading

import numpy as np

from core.model.many import solve_many
from core.model.statics import Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Indices

#: Poses that are tried, and how many between two looks whether to end.
POSES, AT_ONCE = 1500, 100
#: Cuts across the axis, and corners of each ring.
CUTS, CORNERS = 28, 48


def reachable_tips(
    statics: Statics, limits: Limits, poses: int = POSES, ending: threading.Event | None = None
) -> Array:
    """Tips (k, 3) [m] of unloaded poses spread evenly over the joints' travel; poses that cannot be are left out."""
    lower = np.array([limit.lower for limit in limits.joints])
    upper = np.array([limit.upper for limit in limits.joints])
    joints = lower + np.random.default_rng(0).random((poses, len(lower))) * (upper - lower)
    tips = [np.empty((0, 3))]
    for some in np.split(joints, range(AT_ONCE, poses, AT_ONCE)):
        if ending is not None and ending.is_set():
            break
        solved = solve_many(statics, some, np.zeros((len(some), 6)))
        tips.append(solved.tip[solved.ok])
    return np.concatenate(tips)


def turns_as_a_whole(limits: Limits, statics: Statics) -> bool:
    """Whether every tube can turn by a whole turn: then the workspace is round about the plate's axis."""
    robot = statics.robot
    turning = {
        joint.tube
        for joint, limit in zip(robot.joints, limits.joints, strict=True)
        if joint.motion == "rotation" and limit.upper - limit.lower >= 2.0 * np.pi
    }
    return turning == set(range(len(robot.tubes)))


def hull(tips: Array) -> tuple[Array, Indices]:
    """Corners (v, 3) [m] and triangles (f, 3) of the least convex body around tips (k, 3) [m]."""
    from scipy.spatial import ConvexHull  # here: slow to import, and most robots turn as a whole

    found = ConvexHull(tips)
    faces = found.simplices.astype(np.int64)
    one, two, three = (tips[faces[:, corner]] for corner in range(3))
    inward = np.einsum("fi,fi->f", np.cross(two - one, three - one), found.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return tips, faces


def bell(tips: Array, cuts: int = CUTS, corners: int = CORNERS) -> tuple[Array, Indices]:
    """A surface of revolution around tips (k, 3) [m] about the z axis: in every cut from the least to the largest
    distance from it.

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


class Workspace:
    """The hull of one robot, computed once in a thread of its own when it is first asked for."""

    def __init__(self, statics: Statics, limits: Limits) -> None:
        self._statics, self._limits = statics, limits
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._surface: tuple[Array, Indices] | None = None

    def surface(self) -> tuple[Array, Indices] | None:
        """Corners (v, 3) [m] and triangles (f, 3), world frame; None while they are being computed."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._compute, name="workspace", daemon=True)
            self._thread.start()
        return self._surface

    def close(self) -> None:
        """End the computation."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()

    def _compute(self) -> None:
        tips = reachable_tips(self._statics, self._limits, POSES, self._ending)
        if self._ending.is_set() or len(tips) < 2 * CUTS:
            return
        base = self._statics.robot.base
        around, to = base.rotation, np.array(base.position)
        if turns_as_a_whole(self._limits, self._statics):
            corners, faces = bell((tips - to) @ around)
            self._surface = corners @ around.T + to, faces
        else:
            self._surface = hull(tips)
