"""Objects of the scene that can be switched on: unloaded shape, workspace, and uncertainty of the estimated tip."""

import threading

import numpy as np
import viser
from pydantic import ConfigDict

from core.errors import CtrError
from core.model.batch import solve_many
from core.model.statics import Solution, Statics
from core.robot.limits import Limits
from core.robot.robot import Array, Indices
from station.config import palette
from station.config.strict import Strict
from web.scene.robot_mesh import centre_line

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
        (profile[:, :1] * np.cos(angle), profile[:, :1] * np.sin(angle), np.repeat(profile[:, 1:], corners, axis=1)),
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


#: Radius of the uncertainty sphere in standard deviations, and the factor by which the sphere is magnified.
UNCERTAINTY_SIGMAS, UNCERTAINTY_SCALE = 2.0, 10.0
GHOST_POINTS = 60


class ViewOptions(Strict):
    """Objects that the scene shows in addition to the robot. All clients have the same options."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"ghost": True, "target": True}]})

    ghost: bool = False
    """shape of the robot without its load"""
    workspace: bool = False
    """tip positions within the joints' travel, without a load"""
    uncertainty: bool = False
    """two standard deviations of the estimated tip, magnified ten times; the region is a sphere, because the
    observer has one covariance for all three axes"""
    true_diameter: bool = False
    """the tubes at their true diameter instead of magnified"""
    target: bool = False
    """a target that can be dragged, to check whether the tip can reach the target"""
    force: bool = False
    """a handle at the end of the force's arrow: drag it to apply a force to the simulated tip (virtual lab)"""


class Overlays:
    """Scene objects that the view options switch on and off."""

    def __init__(self, scene: viser.SceneApi, statics: Statics, workspace: WorkspaceMesh, unit: float) -> None:
        self._statics, self._unit, self._workspace = statics, unit, workspace
        self._scene, self._hull = scene, None
        self._near: Solution | None = None
        self._ghost = scene.add_line_segments(
            "/ghost", np.zeros((GHOST_POINTS - 1, 2, 3)), palette.SLATE,
            thickness=2.0, thickness_units="screen", scale=unit, visible=False,
        )  # fmt: skip
        self._sphere = scene.add_icosphere(
            "/tip/uncertainty", radius=1.0, color=palette.ESTIMATED, opacity=0.25, cast_shadow=False, visible=False
        )

    def update(self, shown: ViewOptions, joints: Array, tip: Array, uncertainty: float) -> None:
        """Draw one frame.

        Args:
            shown: view options.
            joints: joint positions (n,) [rad or m].
            tip: estimated position of the tip (3,) [m].
            uncertainty: standard deviation of the estimated tip [m].
        """
        self._draw_ghost(shown.ghost, joints)
        self._sphere.visible = shown.uncertainty
        if shown.uncertainty:
            self._sphere.position = self._unit * tip
            self._sphere.radius = max(self._unit * UNCERTAINTY_SCALE * UNCERTAINTY_SIGMAS * uncertainty, 1e-3)
        self._draw_workspace(shown.workspace)

    def _draw_workspace(self, shown: bool) -> None:
        surface = self._workspace.surface() if shown and self._hull is None else None
        if surface is not None:
            corners, faces = surface
            self._hull = self._scene.add_mesh_simple(
                "/workspace", corners, faces, color=palette.SKY, opacity=0.22, side="double", scale=self._unit,
                cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
        if self._hull is not None:
            self._hull.visible = shown

    def _draw_ghost(self, shown: bool, joints: Array) -> None:
        points = self._unloaded_line(joints) if shown else None
        self._ghost.visible = points is not None
        if points is not None:
            self._ghost.points = np.stack((points[:-1], points[1:]), axis=1).astype(np.float32)

    def _unloaded_line(self, joints: Array) -> Array | None:
        try:
            self._near = self._statics.solve(joints, np.zeros(6), self._near)
        except CtrError:
            self._near = None  # the model has no unloaded shape at this pose, so none is shown
            return None
        shape = self._statics.shape(self._near)
        return centre_line(shape, np.linspace(0.0, shape[-1, 0], GHOST_POINTS))[0]
