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
from station.service.status import STALE, Status
from station.service.supervisor import Supervisor
from web.scene.contact import SideLoad
from web.scene.contact_mark import ContactMark
from web.scene.history import BIN, SPAN, History
from web.scene.legend import FIELD, VIEWS
from web.scene.reference import path
from web.scene.stage import Stage, draw_grid
from web.scene.tubes import TubeMesh

#: Scene units in a metre.
UNIT = 10.0
#: Length of the force arrow [m/N], and the least force that is drawn [N].
ARROW, LEAST_FORCE = 0.1, 0.015
TRACE_POINTS = round(SPAN / BIN)


class Scene:
    """Everything in the 3D view; built once, then moved."""

    def __init__(self, server: viser.ViserServer, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._statics: Statics = supervisor.statics
        self._near: Solution | None = None
        self._task: Task | None = None
        _place_camera(server)
        scene = server.scene
        draw_grid(scene, UNIT)
        robot = supervisor.robot
        self._stage = Stage(scene, robot, UNIT)
        self._tubes = [TubeMesh(tube) for tube in robot.tubes]
        self._meshes = [
            scene.add_mesh_simple(
                f"/robot/{tube.name}", np.zeros((mesh.count, 3)), mesh.faces,
                color=palette.tube(number), scale=UNIT, visible=False,
            )
            for number, (tube, mesh) in enumerate(zip(robot.tubes, self._tubes, strict=True))
        ]  # fmt: skip
        self._desired = scene.add_icosphere(
            "/tip/desired", radius=0.0035 * UNIT, color=palette.DESIRED, opacity=0.4, cast_shadow=False, visible=False
        )
        self._measured = scene.add_icosphere(
            "/tip/measured", radius=0.0018 * UNIT, color=palette.MEASURED, cast_shadow=False, visible=False
        )
        self._estimated = scene.add_box(
            "/tip/estimated",
            color=palette.ESTIMATED,
            dimensions=np.full(3, 0.0028 * UNIT),
            cast_shadow=False,
            visible=False,
        )
        self._force = scene.add_arrows(
            "/force/arrow", np.zeros((1, 2, 3)), palette.FORCE,
            shaft_radius=0.0009, head_radius=0.0024, head_length=0.007, scale=UNIT, visible=False,
        )  # fmt: skip
        self._contact = ContactMark(scene, UNIT)
        self._newton = scene.add_label("/force/label", "0.00 N", anchor="center-left", visible=False)
        self._stale = scene.add_label("/stale", "", position=(0.0, 0.0, 0.0), anchor="bottom-left", visible=False)
        self._trace = scene.add_line_segments(
            "/trace", np.zeros((TRACE_POINTS, 2, 3)), _fade(palette.MEASURED, TRACE_POINTS),
            thickness=2.0, thickness_units="screen", scale=UNIT, visible=False,
        )  # fmt: skip
        self._path = scene.add_line_segments(
            "/path", np.zeros((1, 2, 3)), palette.DESIRED,
            thickness=1.5, thickness_units="screen", scale=UNIT, visible=False,
        )  # fmt: skip

    def update(self, status: Status, history: History, side_load: SideLoad | None = None) -> None:
        """One frame; what has not changed is not sent again. `side_load` is a load that does not act at the tip."""
        live = bool(status.values) and status.age <= STALE and len(history.recent) > 0
        moving = live and status.phase is Phase.MOVING
        self._show_age(status, live)
        self._measured.visible = live
        self._desired.visible = moving
        if not live:
            self._estimated.visible = self._force.visible = self._newton.visible = False
            self._contact.hide()
            return
        self._measured.position = UNIT * status.values["tip_measured"]
        if moving:
            self._desired.position = UNIT * status.values["tip_desired"]
        force = history.mean("force")
        self._draw_robot(status.values["joints"], force, side_load)
        self._draw_path(status)

    def update_trace(self, history: History) -> None:
        """The way the measured tip has come, the newest end brightest."""
        tips = np.array([point.tip for point in history.points])
        self._trace.visible = len(tips) > 1
        if len(tips) > 1:
            ends = np.concatenate((np.repeat(tips[:1], TRACE_POINTS + 1 - len(tips), axis=0), tips))
            self._trace.points = np.stack((ends[:-1], ends[1:]), axis=1).astype(np.float32)

    def _draw_robot(self, joints: Array, force: Array, side_load: SideLoad | None) -> None:
        """Tubes as the loaded model has them, and the load where it acts."""
        _, beta = self._supervisor.robot.tube_poses(joints)
        length = float(beta[0]) + self._supervisor.robot.tubes[0].length
        contact = None if side_load is None else min(side_load.contact.place, length)
        try:
            self._near = self._statics.solve(joints, np.concatenate((force, np.zeros(3))), self._near, contact)
        except CtrError:
            # The drawing stands still; what is wrong is the control loop's to say.
            self._near, self._estimated.visible = None, False
            return
        shape = self._statics.shape(self._near)
        for tube, mesh, start in zip(self._tubes, self._meshes, beta, strict=True):
            mesh.vertices = tube.vertices(shape, float(start)).astype(np.float32)
            mesh.visible = True
        self._stage.move(beta)
        self._estimated.position = UNIT * self._near.tip
        self._estimated.visible = True
        if side_load is None:
            self._contact.hide()
            self._draw_force(self._near.tip, force)
        else:
            self._draw_force(self._contact.draw(side_load, shape), force)
            self._newton.visible = False  # the contact's own words have it

    def _draw_force(self, place: Array, force: Array) -> None:
        """The load's arrow from where it acts (3,) [m]."""
        size = float(np.linalg.norm(force))
        self._force.visible = self._newton.visible = size >= LEAST_FORCE
        if size >= LEAST_FORCE:
            end = place + ARROW * force
            self._force.points = np.array([[place, end]], dtype=np.float32)
            self._newton.position = UNIT * (end + 0.004 * force / size)
            self._newton.text = f"{size:.2f} N"

    def _draw_path(self, status: Status) -> None:
        task = None if status.run is None else status.run.start.task
        if task is self._task:
            return
        self._path.visible = False
        if task is None or status.phase is Phase.MOVING:
            self._task = task
        if task is not None and status.phase is Phase.MOVING:
            points = path(task, status)
            if len(points) > 1:
                self._path.points = np.stack((points[:-1], points[1:]), axis=1).astype(np.float32)
                self._path.visible = True

    def _show_age(self, status: Status, live: bool) -> None:
        self._stale.visible = not live
        if not live:
            # Half a second at a time: an age that races is not read any better.
            self._stale.text = (
                f"STALE: last telemetry {0.5 * round(2.0 * status.age):.1f} s ago"
                if status.values
                else "no telemetry yet"
            )


def _fade(colour: palette.Colour, count: int) -> np.ndarray:
    """Colours (count, 2, 3) from a grey that is dim on light and dark backgrounds to the full colour."""
    share = np.linspace(0.0, 1.0, count + 1)[:, None]
    shades = (np.array(palette.GREY) + share * np.subtract(colour, palette.GREY)).astype(np.uint8)
    return np.stack((shades[:-1], shades[1:]), axis=1)


def _place_camera(server: viser.ViserServer) -> None:
    """From the side, a little above and in front: the bent part large, the stages at the left."""
    server.scene.set_up_direction("-x")
    camera = server.initial_camera
    camera.fov = FIELD
    camera.position, camera.look_at = (np.array(place) for place in VIEWS["Overview"])
    camera.near, camera.far = 0.01 * UNIT, 10.0 * UNIT
