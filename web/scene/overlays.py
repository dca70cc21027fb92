"""Objects of the scene that can be switched on: unloaded shape, workspace, and uncertainty of the estimated tip."""

import numpy as np
import viser

from core.errors import CtrError
from core.model.statics import Solution, Statics
from core.robot.robot import Array
from station.config import palette
from station.config.strict import Strict
from web.scene.tubes import centre_line
from web.scene.workspace import WorkspaceMesh

#: Radius of the uncertainty sphere in standard deviations, and the factor by which the sphere is magnified.
UNCERTAINTY_SIGMAS, UNCERTAINTY_SCALE = 2.0, 10.0
GHOST_POINTS = 60


class ViewOptions(Strict):
    """Objects that the scene shows in addition to the robot. All clients have the same options."""

    ghost: bool = False
    """shape of the robot without its load"""
    workspace: bool = False
    """tip positions within the joints' travel, without a load"""
    uncertainty: bool = False
    """two standard deviations of the estimated tip, magnified ten times; the region is a sphere, because the
    observer has one covariance for all three axes"""
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
