"""View of the station in viser: a thread that updates the 3D scene."""

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Mapping

import numpy as np
import viser

from core.control.tip_direction import task_selection
from core.errors import CtrError
from core.model.solution import pure_force
from core.robot.robot import Array
from station.config import palette
from station.config.loads import GRAVITY, ConstantLoad, NoLoad
from station.service.commands import ApplyLoad
from station.service.contact import WINDOW_ROWS, ContactMonitor, SideLoad
from station.service.status import STALE_AFTER_S, StationStatus
from station.service.supervisor import Supervisor
from web.scene.cameras import Cameras
from web.scene.content import SceneContent
from web.scene.gizmos import FORCE_HANDLE, FORCE_SIZE_M, TARGET_HANDLE, TARGET_SIZE_M, Gizmo, boxes, handle_force
from web.scene.history import TipTrace
from web.scene.overlays import Overlays, ViewOptions, WorkspaceMesh
from web.scene.proxy import SceneServer
from web.scene.scene import ARROW_SCALE_M_PER_N, UNITS_PER_M, Scene
from web.scene.target import DirectionTarget, TargetCheck, TargetMotion, plan_target_motion

#: Number of pictures a second. Trace and target are updated with every third picture, and the contact
#: with every tenth.
FRAME_RATE_HZ = 30.0
TRACE_EVERY, CONTACT_EVERY = 3, 10
#: Only every sixth picture is drawn while no client is connected. The number is a multiple of `TRACE_EVERY`, so that
#: each drawn picture has its trace.
UNWATCHED_EVERY = 6

log = logging.getLogger(__name__)


class SceneView:
    """Thread that updates the scene on a viser server until `close` is called; the caller owns the server."""

    def __init__(self, server: viser.ViserServer, supervisor: Supervisor) -> None:
        self._server = server
        self._supervisor = supervisor
        # A client could otherwise request a public tunnel from the internet to this server.
        server.request_share_url = _no_share
        self._history = TipTrace(supervisor.channels)
        self._limits = supervisor.bench.limits
        server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=palette.BLUE)
        self._scene = Scene(server, supervisor)
        self.cameras = Cameras(server, self._scene.extent, UNITS_PER_M, lambda: self._scene.drawn)
        self._contact_monitor = ContactMonitor(supervisor.robot, supervisor.statics, supervisor.channels)
        self._workspace = WorkspaceMesh(supervisor.statics, self._limits)
        self._overlays = Overlays(server.scene, supervisor.statics, self._workspace, UNITS_PER_M)
        #: Controller of motions to a target with a direction; None: the station's controller controls no direction.
        file = supervisor.bench.controller
        self.pointing = file if file.task == "position_and_direction" else None
        self._aim = task_selection(file.task, file.direction_weight)
        self._target = Gizmo(server.scene, TARGET_HANDLE, UNITS_PER_M, TARGET_SIZE_M, turns=self.pointing is not None)
        self._force_handle = Gizmo(server.scene, FORCE_HANDLE, UNITS_PER_M, FORCE_SIZE_M)
        self._has_load = False
        self.scene_server = SceneServer(server.get_port(), boxes(UNITS_PER_M), Counter())
        self._shown = ViewOptions()
        self._check = TargetCheck()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="viser view")
        self._thread.start()

    @property
    def drawn(self) -> SceneContent:
        """Content of the last picture around the tip, for the close-up."""
        return self._scene.drawn

    @property
    def shown(self) -> ViewOptions:
        """View options, which are the same for all clients."""
        return self._shown

    def side_load(self) -> SideLoad | None:
        """Return the load that acts on the shaft instead of the tip; None: there is none."""
        return self._contact_monitor.side_load

    def show(self, shown: ViewOptions) -> None:
        """Set the view options. When the target is switched on, it appears at the tip."""
        values = self._supervisor.status().values
        if shown.target and not self._shown.target and "tip_observed" in values:
            self.set_target(values["tip_observed"], self._heading(values))
        self._shown = shown

    def set_target(self, position: Array, direction: Array | None = None) -> None:
        """Move the target to `position` (3,) [m] and set the tip's direction there (3,); None: unchanged."""
        self._target.put(position, direction)

    @property
    def target(self) -> Array:
        """Position of the target (3,) [m]."""
        return self._target.position

    @property
    def target_direction(self) -> Array | None:
        """Desired direction of the tip at the target (3,); None: the direction is not controlled."""
        return None if self.pointing is None else self._target.direction

    def target_check(self) -> TargetMotion:
        """Return the last planned motion to the target, or after a change a new one; see `TargetCheck`."""
        values = self._supervisor.status().values
        if not values:
            return self.motion_to_target()
        state = (self._target.position, self._target.direction, values["joints"], values["force_filtered"])
        return self._check.plan(state, self.motion_to_target)

    def motion_to_target(self) -> TargetMotion:
        """Plan the motion of the tip from its present position to the target."""
        values = self._supervisor.status().values
        if not values:
            return TargetMotion(None, 0.0, "there is no telemetry before the stages are homed")
        pointing = None
        if self.pointing is not None:
            # The motion starts with the model's direction, not with the measured one, because the check uses the model.
            heading = self._modelled(values)
            if heading is None:
                return TargetMotion(None, 0.0, "the direction of the tip is not known now")
            pointing = DirectionTarget(self._aim, heading, self._target.direction)
        return plan_target_motion(
            self._target.position, self._supervisor.statics, self._limits, values["joints"], values["tip_observed"],
            values["force_filtered"], pointing,
        )  # fmt: skip

    def _heading(self, values: Mapping[str, Array]) -> Array | None:
        """Return the observed direction of the tip (3,), or the model's direction if there is no observed one."""
        if self.pointing is None:
            return None
        observed = values["direction_observed"]
        return observed if observed.any() and np.isfinite(observed).all() else self._modelled(values)

    def _modelled(self, values: Mapping[str, Array]) -> Array | None:
        """Return the direction of the tip by the model (3,); None: the model has no solution."""
        try:
            solution = self._supervisor.statics.solve(values["joints"], pure_force(values["force_filtered"]))
        except CtrError:
            return None
        return solution.rotation[:, 2]

    def close(self) -> None:
        """End the updating thread; the caller stops the viser server."""
        self._end.set()
        self._thread.join()
        self._workspace.close()

    def _run(self) -> None:
        due, number = time.monotonic(), 0
        while not self._end.wait(max(0.0, due - time.monotonic())):
            try:
                if number % CONTACT_EVERY == 0:
                    self._update_contact()
                if number % UNWATCHED_EVERY == 0 or self._server.get_clients():
                    self._frame(slow=number % TRACE_EVERY == 0)
            except Exception as error:
                # The thread continues, as the next picture may succeed. The pause limits the log to one entry a second.
                if not _is_race_in_viser(error):
                    log.exception("a picture of the scene failed")
                    self._end.wait(1.0)
            number += 1
            due = max(due + 1.0 / FRAME_RATE_HZ, time.monotonic())

    def _update_contact(self) -> None:
        ring = self._supervisor.ring
        rows = ring.read(max(ring.written - WINDOW_ROWS, 0))[0]
        self._contact_monitor.update(rows if self._supervisor.status().age <= STALE_AFTER_S else rows[:0])

    def _frame(self, *, slow: bool) -> None:
        status = self._supervisor.status()
        self._history.read(self._supervisor.ring)
        with self._server.atomic():
            self._scene.update(status, self._history, self.side_load(), true_diameter=self._shown.true_diameter)
            self._overlay(status)
            if slow:
                self._scene.update_trace(self._history)
                self._target.show(self._shown.target)
                self._update_force_handle(status)
        self.cameras.follow(reframe=slow)

    def _overlay(self, status: StationStatus) -> None:
        values = status.values
        live = bool(values) and status.age <= STALE_AFTER_S and bool(np.isfinite(values["joints"]).all())
        shown = self._shown if live else ViewOptions()
        if live:
            uncertainty = math.sqrt(values["bias_covariance"][0])
            self._overlays.update(shown, values["joints"], values["tip_observed"], uncertainty)

    def _update_force_handle(self, status: StationStatus) -> None:
        """Apply the force of the dragged handle to the simulated tip; otherwise move the handle to the arrow's end."""
        shown = self._shown.force and bool(status.values) and self._supervisor.bench.devices is None
        self._force_handle.show(shown)
        if not shown:
            if self._has_load:
                self._has_load = False
                self._supervisor.send(ApplyLoad(load=NoLoad()))
            return
        tip = status.values["tip_observed"]
        dragged = self._force_handle.dragged()
        if dragged is not None:
            force = handle_force(dragged, tip, ARROW_SCALE_M_PER_N)
            size = float(np.linalg.norm(force))
            self._has_load = True
            load = ConstantLoad(magnitude=size, direction=_direction(force, size))
            self._supervisor.send(ApplyLoad(load=load))
        else:
            self._force_handle.put(tip + ARROW_SCALE_M_PER_N * self._history.mean("force"))


def _is_race_in_viser(error: Exception) -> bool:
    """Return whether viser's list of senders changed while a frame notified them; the next frame notifies all."""
    return isinstance(error, RuntimeError) and str(error) == "deque mutated during iteration"


def _direction(force: Array, size: float) -> tuple[float, float, float]:
    """Return the direction of a force (3,) [N]; down for a zero force."""
    x, y, z = (force / size).tolist() if size > 1e-6 else GRAVITY
    return x, y, z


def _no_share(verbose: bool = True) -> str | None:  # noqa: ARG001 - viser's signature
    log.warning("a client requested a public share link; refused")
    return None
