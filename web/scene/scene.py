"""The robot as it stands, with its markers, its load, its path and a millimetre grid.

World frame as in `core`: +z along the straight tubes, gravity along +x, so that x points down on
the screen. The scene's unit is the decimetre: viser's shadows and camera suit scenes of that size.
"""

import numpy as np
import viser

from core.errors import CtrError
from core.model.statics import Solution, Statics
from core.robot.robot import Array
from station.config import palette
from station.control.loop import Phase, Task
from station.service.status import Status
from station.service.supervisor import Supervisor
from web.scene.contact import SideLoad
from web.scene.contact_mark import ContactMark
from web.scene.drawn import LINE, NONE, NOTHING, POINTS, Drawn
from web.scene.extent import extent, translations
from web.scene.fresh import Fresh, fresh
from web.scene.grid import Grid, draw_grid
from web.scene.history import BIN, SPAN, History
from web.scene.pointing_mark import PointingMark
from web.scene.reference import path
from web.scene.stage import Stage
from web.scene.target_mark import TargetMark
from web.scene.tubes import TubeMesh, centre_line
from web.scene.views import ASPECT, camera

#: Scene units in a metre.
UNIT = 10.0
#: Length of the force arrow [m/N].
ARROW = 0.1
#: A force that is larger is drawn, until it is smaller: noise and drift alone make no arrow that comes and goes [N].
SHOWN, HIDDEN = 0.04, 0.025
TRACE_POINTS = round(SPAN / BIN)
#: Of tubes whose joints are not measured now.
FADED = 0.35


class Scene:
    """Everything in the 3D view; built once, then moved."""

    def __init__(self, server: viser.ViserServer, supervisor: Supervisor) -> None:
        self.drawn: Drawn = NOTHING  #: the last picture; may be read by any thread
        self._supervisor = supervisor
        self._statics: Statics = supervisor.statics
        self._near: Solution | None = None
        self._task: Task | None = None
        self._loaded = False  # there is a force to draw
        scene, robot, limits = server.scene, supervisor.robot, supervisor.bench.robot.limits()
        self.extent = extent(robot, limits)  #: what it takes, for cameras
        first = camera("Overview", self.extent, np.zeros(3), ASPECT)
        draw_grid(scene, Grid.around(self.extent), float(np.linalg.norm(first.eye - first.centre)), UNIT)
        self._stage = Stage(scene, robot, float(translations(robot, limits)[0].min()), UNIT)
        self._tubes = [TubeMesh(tube) for tube in robot.tubes]
        self._meshes = [
            scene.add_mesh_simple(
                f"/robot/{tube.name}", np.zeros((mesh.count, 3)), mesh.faces,
                color=palette.tube(number), scale=UNIT, visible=False,
            )
            for number, (tube, mesh) in enumerate(zip(robot.tubes, self._tubes, strict=True))
        ]  # fmt: skip
        self._desired = scene.add_icosphere(
            "/tip/desired", radius=0.0045 * UNIT, color=palette.DESIRED, opacity=0.5, cast_shadow=False, visible=False
        )
        self._measured = scene.add_icosphere(
            "/tip/measured", radius=0.0022 * UNIT, color=palette.MEASURED, cast_shadow=False, visible=False
        )
        self._estimated = scene.add_box(
            "/tip/estimated",
            color=palette.ESTIMATED,
            dimensions=np.full(3, 0.0032 * UNIT),
            cast_shadow=False,
            visible=False,
        )
        self._force = scene.add_arrows(
            "/force/arrow", np.zeros((1, 2, 3)), palette.FORCE,
            shaft_radius=0.0011, head_radius=0.003, head_length=0.008, scale=UNIT, visible=False,
        )  # fmt: skip
        self._contact = ContactMark(scene, UNIT)
        self._target = TargetMark(scene, UNIT)
        self._pointing = PointingMark(scene, UNIT)
        self._trace = scene.add_line_segments(
            "/trace", np.zeros((TRACE_POINTS, 2, 3)), _fade(palette.MEASURED, TRACE_POINTS),
            thickness=3.5, thickness_units="screen", scale=UNIT, visible=False,
        )  # fmt: skip
        self._path = scene.add_line_segments(
            "/path", np.zeros((1, 2, 3)), palette.DESIRED,
            thickness=2.5, thickness_units="screen", scale=UNIT, visible=False,
        )  # fmt: skip
        self._path_points = NONE

    def update(self, status: Status, history: History, side_load: SideLoad | None = None) -> None:
        """One frame; what has not changed is not sent again, what is not measured now is not drawn as if it were.

        `side_load` is a load that does not act at the tip.
        """
        now = fresh(status, history)
        moving = now.row and status.phase is Phase.MOVING
        measured = status.values["tip_measured"] if now.tip else None
        desired = status.values["tip_desired"] if moving else None
        self._put(self._measured, measured)
        self._put(self._desired, desired)
        self._draw_target(status, seen=now.row and history.target_seen)
        self._draw_direction(status, measured, moving=moving)
        for mesh in self._meshes:
            mesh.opacity = None if now.joints else FADED
        if not now.row:
            self._hide_load()
            self._put(self._estimated, None)
            says = "old: no telemetry" if status.values else NOTHING.says
            self.drawn = self.drawn._replace(
                says=says, age=status.age if status.values else 0.0, estimated=None, measured=None, desired=None,
                force=None, place=None, contact="",
            )  # fmt: skip
            return
        force = history.mean("force") if now.force else np.zeros(3)
        self._draw_path(status)
        self._draw_robot(status, force, side_load if now.force else None, now)
        self.drawn = self.drawn._replace(
            says=now.says, age=status.age, measured=measured, desired=desired, trace=history.trace,
            path=self._path_points if moving else NONE,
        )  # fmt: skip

    def update_trace(self, history: History) -> None:
        """The way the measured tip has come, the newest end brightest."""
        tips = history.trace[-TRACE_POINTS:]
        self._trace.visible = len(tips) > 1
        if len(tips) > 1:
            ends = np.concatenate((np.repeat(tips[:1], TRACE_POINTS + 1 - len(tips), axis=0), tips))
            self._trace.points = np.stack((ends[:-1], ends[1:]), axis=1).astype(np.float32)

    def _draw_robot(self, status: Status, force: Array, side_load: SideLoad | None, now: Fresh) -> None:
        """Tubes as the loaded model has them, and the load where it acts."""
        joints = status.values["joints"]
        _, beta = self._supervisor.robot.tube_poses(joints)
        length = float(beta[0]) + self._supervisor.robot.tubes[0].length
        contact = None if side_load is None else min(side_load.contact.place, length)
        try:
            self._near = self._statics.solve(joints, np.concatenate((force, np.zeros(3))), self._near, contact)
        except CtrError:
            # The drawing stands still; what is wrong is the control loop's to say.
            self._near = None
            self._put(self._estimated, None)
            self._hide_load()
            self.drawn = self.drawn._replace(tubes=(), estimated=None, force=None, place=None, contact="")
            return
        shape = self._statics.shape(self._near)
        for tube, mesh, start in zip(self._tubes, self._meshes, beta, strict=True):
            mesh.vertices = tube.vertices(shape, float(start)).astype(np.float32)
            mesh.visible = True
        self._stage.move(beta)
        estimated = self._near.tip if now.force and now.joints else None
        self._put(self._estimated, estimated)
        place = self._near.tip
        if side_load is None:
            self._contact.hide()
        else:
            place = self._contact.draw(side_load, shape)
        shown = self._draw_force(place, force)
        self.drawn = self.drawn._replace(
            tubes=tuple(
                _end_of_line(shape, max(length - LINE, float(start)), min(float(start) + tube.length, length))
                for tube, start in zip(self._supervisor.robot.tubes, beta, strict=True)
            ),
            estimated=estimated, force=force if shown else None, place=place if shown else None,
            contact="" if side_load is None else side_load.place if side_load.contact.located else "place not known",
        )  # fmt: skip

    def _draw_force(self, place: Array, force: Array) -> bool:
        """The load's arrow from where it acts (3,) [m]; whether there is one."""
        size = float(np.linalg.norm(force))
        self._loaded = size >= (HIDDEN if self._loaded else SHOWN)
        self._force.visible = self._loaded
        if self._loaded:
            self._force.points = np.array([[place, place + ARROW * force]], dtype=np.float32)
        return self._loaded

    def _draw_target(self, status: Status, *, seen: bool) -> None:
        """Where a target is now, as far as its rhythms tell, and the offset from it while a run follows it."""
        values = status.values
        followed = seen and status.phase is Phase.MOVING and values["target_followed"][0] > 0.0
        self._target.draw(values["target_predicted"] if seen else None, values["target_offset"] if followed else None)

    def _draw_direction(self, status: Status, tip: Array | None, *, moving: bool) -> None:
        """Where the measured tip (3,) [m] points, and should while a motion is on, if somebody asks for it."""
        observed, desired = (
            None if name in status.standing else status.values.get(name)
            for name in ("direction_observed", "direction_desired")
        )
        self._pointing.draw(tip, observed, desired if moving else None)

    def _hide_load(self) -> None:
        self._loaded = self._force.visible = False
        self._contact.hide()

    def _draw_path(self, status: Status) -> None:
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

    def _put(self, marker: viser.IcosphereHandle | viser.BoxHandle, place: Array | None) -> None:
        """A marker at (3,) [m], or none."""
        marker.visible = place is not None
        if place is not None:
            marker.position = UNIT * place


def _end_of_line(shape: Array, begin: float, end: float) -> Array:
    """Of a tube between two arc lengths [m]: (k, 3) [m]; nothing where it ends before."""
    return centre_line(shape, np.linspace(begin, end, POINTS))[0] if end > begin else NONE


def _fade(colour: palette.Colour, count: int) -> np.ndarray:
    """Colours (count, 2, 3) from a grey that is dim on light and dark backgrounds to the full colour."""
    share = np.linspace(0.0, 1.0, count + 1)[:, None]
    shades = (np.array(palette.GREY) + share * np.subtract(colour, palette.GREY)).astype(np.uint8)
    return np.stack((shades[:-1], shades[1:]), axis=1)
