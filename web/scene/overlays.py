"""What the scene shows on demand: the unloaded shape, where the tip can go, how sure its estimate is."""

import numpy as np
import viser

from core.errors import CtrError
from core.model.statics import Solution, Statics
from core.robot.robot import Array
from station.config import palette
from station.config.strict import Strict
from web.scene.tubes import centre_line
from web.scene.workspace import Workspace

#: The sphere of the estimate's uncertainty: standard deviations, and how much larger than life.
SIGMAS, LARGER = 2.0, 10.0
GHOST_POINTS = 60


class Shown(Strict):
    """What the scene shows beside the robot; the same for everybody."""

    ghost: bool = False
    """the shape that the robot would have without its load"""
    workspace: bool = False
    """tips that the joints' travel allows, without a load"""
    uncertainty: bool = False
    """two standard deviations of the estimated tip, ten times as large; the same in all directions, since the
    observer has one covariance for the three axes"""
    target: bool = False
    """a place that can be dragged, to see whether the tip can get there"""
    force: bool = False
    """a handle at the end of the force's arrow: drag to pull at the simulated tip (virtual lab)"""


class Overlays:
    """Handles of what is shown on demand."""

    def __init__(self, scene: viser.SceneApi, statics: Statics, workspace: Workspace, unit: float) -> None:
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

    def update(self, shown: Shown, joints: Array, tip: Array, uncertainty: float) -> None:
        """One frame: joints (n,), the estimated tip (3,) [m] and its standard deviation [m]."""
        self._draw_ghost(shown.ghost, joints)
        self._sphere.visible = shown.uncertainty
        if shown.uncertainty:
            self._sphere.position = self._unit * tip
            self._sphere.radius = max(self._unit * LARGER * SIGMAS * uncertainty, 1e-3)
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
            self._near = None  # nothing to show: this pose has no unloaded shape
            return None
        shape = self._statics.shape(self._near)
        return centre_line(shape, np.linspace(0.0, shape[-1, 0], GHOST_POINTS))[0]
