"""3D scene: the robot with its markers, its load and its path, and two grids.

World frame as in `core`: +z along the straight tubes, gravity along +x, so that x points down on the
screen. The scene's unit is the decimetre, a size for which viser's shadows and camera work well.
"""

import numpy as np
import viser

from core.errors import CtrError
from core.model.backbone import backbone
from core.model.statics import Solution, Statics
from core.robot.robot import FLUSH_TOLERANCE_M, Array
from station.config import palette
from station.control.loop import MotionTask, Phase
from station.service.contact import SideLoad
from station.service.status import StationStatus
from station.service.supervisor import Supervisor
from web.scene.cameras import DEFAULT_ASPECT, FOLLOWING_VIEW, camera, extent, translations
from web.scene.content import CLOSE_UP_LENGTH_M, NO_POINTS, NOTHING, SceneContent, path
from web.scene.grid import Grid, draw_grid
from web.scene.history import TRACE_BIN_S, TRACE_SPAN_S, TipTrace, Validity, validity_of
from web.scene.lights import add_lights
from web.scene.marks import TUBE_MAGNIFICATION, ContactMark, PointingMark, TargetMark
from web.scene.model_error import ModelEnd, TipOffset
from web.scene.regions import RegionMarks
from web.scene.robot_mesh import Bend, StageMesh, TubeMesh

#: Number of scene units in a metre.
UNITS_PER_M = 10.0
#: Length of the force arrow for each newton [m/N].
ARROW_SCALE_M_PER_N = 0.1
#: Forces at which the force arrow appears and disappears [N]; they differ so that noise does not make it flicker.
SHOW_FORCE_N, HIDE_FORCE_N = 0.04, 0.025
TRACE_POINTS = round(TRACE_SPAN_S / TRACE_BIN_S)
#: Opacity of the drawn tubes while their joints are not measured.
FADED_OPACITY = 0.35


class Scene:
    """All objects of the 3D view, which are created once and then updated."""

    def __init__(self, server: viser.ViserServer, supervisor: Supervisor) -> None:
        self.drawn: SceneContent = NOTHING  #: content of the last picture; any thread may read it
        self._supervisor = supervisor
        self._statics: Statics = supervisor.statics
        self._near: Solution | None = None
        self._task: MotionTask | None = None
        self._loaded = False  # whether the force arrow is shown
        self._magnification = TUBE_MAGNIFICATION
        scene, robot, limits = server.scene, supervisor.robot, supervisor.bench.limits
        self.extent = extent(robot, limits)  #: bounds for the cameras
        first = camera(FOLLOWING_VIEW, self.extent, np.zeros(3), DEFAULT_ASPECT)
        draw_grid(scene, Grid.around(self.extent), float(np.linalg.norm(first.eye - first.centre)), UNITS_PER_M)
        add_lights(scene)
        self._stage = StageMesh(scene, robot, float(translations(robot, limits)[0].min()), UNITS_PER_M)
        self._tubes = [TubeMesh(tube) for tube in robot.tubes]
        self._meshes = [
            scene.add_mesh_simple(
                f"/robot/{tube.name}", np.zeros((mesh.count, 3)), mesh.faces,
                color=palette.tube(number), scale=UNITS_PER_M, visible=False,
            )
            for number, (tube, mesh) in enumerate(zip(robot.tubes, self._tubes, strict=True))
        ]  # fmt: skip
        self._desired = scene.add_icosphere(
            "/tip/desired", radius=0.0045 * UNITS_PER_M, color=palette.DESIRED, opacity=0.5, cast_shadow=False,
            visible=False,
        )  # fmt: skip
        self._measured = scene.add_icosphere(
            "/tip/measured", radius=0.0032 * UNITS_PER_M, color=palette.MEASURED, cast_shadow=False, visible=False
        )
        self._estimated = scene.add_box(
            "/tip/estimated", color=palette.ESTIMATED, dimensions=np.full(3, 0.0044 * UNITS_PER_M), cast_shadow=False,
            visible=False,
        )  # fmt: skip
        self._force = scene.add_arrows(
            "/force/arrow", np.zeros((1, 2, 3)), palette.FORCE,
            shaft_radius=0.0011, head_radius=0.003, head_length=0.008, scale=UNITS_PER_M, visible=False,
        )  # fmt: skip
        self._offset, self._model_end = TipOffset(), ModelEnd(scene, UNITS_PER_M)
        self._contact = ContactMark(scene, UNITS_PER_M)
        self._regions = RegionMarks(scene, limits.others, UNITS_PER_M)
        self._target = TargetMark(scene, UNITS_PER_M)
        self._pointing = PointingMark(scene, UNITS_PER_M)
        self._trace = scene.add_line_segments(
            "/trace", np.zeros((TRACE_POINTS, 2, 3)), _fade(palette.MEASURED, TRACE_POINTS),
            thickness=3.5, thickness_units="screen", scale=UNITS_PER_M, visible=False,
        )  # fmt: skip
        self._path = scene.add_line_segments(
            "/path", np.zeros((1, 2, 3)), palette.DESIRED,
            thickness=2.5, thickness_units="screen", scale=UNITS_PER_M, visible=False,
        )  # fmt: skip
        self._path_points = NO_POINTS

    def update(
        self,
        status: StationStatus,
        history: TipTrace,
        side_load: SideLoad | None = None,
        *,
        true_diameter: bool = False,
    ) -> None:
        """Draw one frame. Stale values are not drawn as current, and an unchanged path is not sent again.

        Args:
            status: status of the station.
            history: recent telemetry.
            side_load: load that acts on the shaft instead of the tip.
            true_diameter: draw the tubes at their true diameter instead of magnified.
        """
        self._magnification = 1.0 if true_diameter else TUBE_MAGNIFICATION
        now = validity_of(status, history)
        moving = now.row and status.phase is Phase.MOVING
        measured = status.values["tip_measured"] if now.tip else None
        desired = status.values["tip_desired"] if moving else None
        self._put(self._measured, measured)
        self._put(self._desired, desired)
        self._draw_target(status, seen=now.row and history.target_visible)
        self._draw_direction(status, measured, moving=moving)
        for mesh in self._meshes:
            mesh.opacity = None if now.joints else FADED_OPACITY
        if not now.row:
            self._hide_load()
            self._hide_model()
            message = "stale: no telemetry" if status.values else NOTHING.message
            self.drawn = self.drawn._replace(
                message=message, age=status.age if status.values else 0.0, estimated=None, measured=None, desired=None,
                force=None, place=None, contact="", model_end=NO_POINTS, model_error=None,
            )  # fmt: skip
            return
        force = history.mean("force") if now.force else np.zeros(3)
        self._draw_path(status)
        self._draw_robot(status, force, side_load if now.force else None, now, measured)
        self.drawn = self.drawn._replace(
            message=now.message, age=status.age, measured=measured, desired=desired, trace=history.trace,
            path=self._path_points if moving else NO_POINTS,
        )  # fmt: skip

    def update_trace(self, history: TipTrace) -> None:
        """Draw the trace of the measured tip, newest part brightest."""
        tips = history.trace[-TRACE_POINTS:]
        self._trace.visible = len(tips) > 1
        if len(tips) > 1:
            ends = np.concatenate((np.repeat(tips[:1], TRACE_POINTS + 1 - len(tips), axis=0), tips))
            self._trace.points = np.stack((ends[:-1], ends[1:]), axis=1).astype(np.float32)

    def _draw_robot(
        self, status: StationStatus, force: Array, side_load: SideLoad | None, now: Validity, measured: Array | None
    ) -> None:
        """Draw the tubes as the loaded model predicts them, bent to the measured tip, and the load where it acts."""
        joints = status.values["joints"]
        _, beta = self._supervisor.robot.tube_poses(joints)
        ends = self._supervisor.robot.tube_ends(joints)
        length = max(float(ends[0]), FLUSH_TOLERANCE_M)
        contact = None if side_load is None else min(side_load.contact.arc_length, max(float(ends.max()), 0.0))
        try:
            self._near = self._statics.solve(joints, np.concatenate((force, np.zeros(3))), self._near, contact)
        except CtrError:
            # The model has no solution: the drawn tubes stay unchanged, and the control loop reports the cause.
            self._near = None
            self._hide_model()
            self._hide_load()
            self.drawn = self.drawn._replace(
                tubes=(), estimated=None, force=None, place=None, contact="", model_end=NO_POINTS, model_error=None
            )
            return
        shape = self._statics.shape(self._near)
        offset = self._offset.update(None if measured is None or not now.joints else measured - self._near.tip)
        bend = Bend(offset, length)
        lines = [tube.line(shape, float(start), bend) for tube, start in zip(self._tubes, beta, strict=True)]
        for tube, mesh, line in zip(self._tubes, self._meshes, lines, strict=True):
            mesh.vertices = tube.vertices(line, self._magnification).astype(np.float32)
            mesh.visible = True
        self._stage.move(beta)
        estimated = self._near.tip if now.force and now.joints else None
        self._put(self._estimated, estimated)
        model_end = self._model_end.draw(shape, length, self._offset)
        position = self._near.tip + offset
        if self._regions.any:
            self._regions.draw(backbone(self._statics, self._near, position))
        if side_load is None:
            self._contact.hide()
        else:
            position = self._contact.draw(side_load, shape, bend, self._magnification)
        shown = self._draw_force(position, force)
        self.drawn = self.drawn._replace(
            tubes=tuple(line.beyond(length - CLOSE_UP_LENGTH_M) for line in lines),
            estimated=estimated, force=force if shown else None, place=position if shown else None,
            contact=_contact_text(side_load), robot=max(lines, key=lambda line: float(line.arc[-1])).beyond(0.0),
            model_end=model_end, model_error=self._offset.error,
        )  # fmt: skip

    def _draw_force(self, position: Array, force: Array) -> bool:
        """Draw the arrow of a load at `position` (3,) [m]; return whether it is shown."""
        size = float(np.linalg.norm(force))
        self._loaded = size >= (HIDE_FORCE_N if self._loaded else SHOW_FORCE_N)
        self._force.visible = self._loaded
        if self._loaded:
            self._force.points = np.array([[position, position + ARROW_SCALE_M_PER_N * force]], dtype=np.float32)
        return self._loaded

    def _draw_target(self, status: StationStatus, *, seen: bool) -> None:
        """Draw the predicted position of a moving target, and the tip's offset from it while a run follows it."""
        values = status.values
        followed = seen and status.phase is Phase.MOVING and values["target_followed"][0] > 0.0
        self._target.draw(values["target_predicted"] if seen else None, values["target_offset"] if followed else None)

    def _draw_direction(self, status: StationStatus, tip: Array | None, *, moving: bool) -> None:
        """Draw the direction of the measured tip (3,) [m], and the desired one during a motion, if it is controlled."""
        observed, desired = (
            None if name in status.stale_groups else status.values.get(name)
            for name in ("direction_observed", "direction_desired")
        )
        self._pointing.draw(tip, observed, desired if moving else None)

    def _hide_model(self) -> None:
        self._regions.draw(None)
        self._offset.update(None)
        self._model_end.hide()
        self._put(self._estimated, None)

    def _hide_load(self) -> None:
        self._loaded = self._force.visible = False
        self._contact.hide()

    def _draw_path(self, status: StationStatus) -> None:
        task = None if status.run is None else status.run.start.task
        if task is self._task:
            return
        self._path.visible = False
        if task is None or status.phase is Phase.MOVING:
            self._task = task
        if task is not None and status.phase is Phase.MOVING:
            points = self._path_points = path(task, status)
            if len(points) > 1:
                self._path.points = np.stack((points[:-1], points[1:]), axis=1).astype(np.float32)
                self._path.visible = True

    def _put(self, marker: viser.IcosphereHandle | viser.BoxHandle, position: Array | None) -> None:
        """Show a marker at `position` (3,) [m]; None hides the marker."""
        marker.visible = position is not None
        if position is not None:
            marker.position = UNITS_PER_M * position


def _contact_text(side_load: SideLoad | None) -> str:
    """Return the position of a contact on the shaft as text; empty without a contact."""
    if side_load is None:
        return ""
    return side_load.position_text if side_load.contact.located else "position unknown"


def _fade(colour: palette.Colour, count: int) -> np.ndarray:
    """Return colours (count, 2, 3) that fade from a grey, which is dim on light and dark pages, to the full colour."""
    share = np.linspace(0.0, 1.0, count + 1)[:, None]
    shades = (np.array(palette.GREY) + share * np.subtract(colour, palette.GREY)).astype(np.uint8)
    return np.stack((shades[:-1], shades[1:]), axis=1)
