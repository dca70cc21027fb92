"""The viser view of the station: one thread that keeps the scene up to date."""

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Mapping

import numpy as np
import viser

from core.control.pointing import aim
from core.errors import CtrError
from core.model.solution import pure_force
from core.robot.robot import Array
from station.config import palette
from station.lab.loads import GRAVITY, ConstantLoad, NoLoad
from station.service.station_service import StationService
from station.service.status import STALE, Status
from web.scene.cameras import Cameras
from web.scene.contact import ROWS, ContactMonitor, SideLoad
from web.scene.drawn import Drawn
from web.scene.gizmos import FORCE, FORCE_SIZE, TARGET, TARGET_SIZE, Gizmo, boxes, pull
from web.scene.history import History
from web.scene.overlays import Overlays, Shown
from web.scene.proxy import SceneServer
from web.scene.scene import ARROW, UNIT, Scene
from web.scene.target import Pointing, Way, way_to
from web.scene.workspace import Workspace

#: Pictures a second; trace and target come with every third, a look at the load with every tenth.
RATE = 30.0
SLOW, LOOK = 3, 10
#: While nobody looks every sixth is enough; a multiple of `SLOW`, so that all is in it.
UNWATCHED = 6

log = logging.getLogger(__name__)


class View:
    """The scene on a viser server of the caller's, until closed."""

    def __init__(self, server: viser.ViserServer, service: StationService) -> None:
        self._server = server
        self._service = service
        self._supervisor = service.supervisor
        # A client may ask for a public tunnel to this server: there is none.
        server.request_share_url = _no_share
        self._history = History(service.supervisor.channels)
        self._limits = service.supervisor.bench.robot.limits()
        server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=palette.BLUE)
        self._scene = Scene(server, service.supervisor)
        self.cameras = Cameras(server, self._scene.extent, UNIT, lambda: self._scene.drawn.tip)
        self._contact_monitor = ContactMonitor(
            service.supervisor.robot, service.supervisor.statics, service.supervisor.channels
        )
        self._workspace = Workspace(service.supervisor.statics, self._limits)
        self._overlays = Overlays(server.scene, service.supervisor.statics, self._workspace, UNIT)
        #: By which the tip goes to the target where the station controls its direction, too.
        file = service.supervisor.bench.controller
        self.pointing = file if file.task == "position_and_direction" else None
        self._aim = aim(file.task, file.direction_weight)
        self._target = Gizmo(server.scene, TARGET, UNIT, TARGET_SIZE, turns=self.pointing is not None)
        self._hand = Gizmo(server.scene, FORCE, UNIT, FORCE_SIZE)
        self._pulls = False
        self.scene_server = SceneServer(server.get_port(), boxes(UNIT), Counter())
        self._shown = Shown()
        self._way: Way | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="viser view")
        self._thread.start()

    @property
    def drawn(self) -> Drawn:
        """What the last picture shows around the tip."""
        return self._scene.drawn

    @property
    def shown(self) -> Shown:
        """What is shown beside the robot."""
        return self._shown

    def side_load(self) -> SideLoad | None:
        """A load that does not act at the tip."""
        return self._contact_monitor.side_load

    def show(self, shown: Shown) -> None:
        """Show something else beside the robot; a target begins at the tip."""
        values = self._supervisor.status().values
        if shown.target and not self._shown.target and "tip_observed" in values:
            self.place_target(values["tip_observed"], self._heading(values))
        self._shown = shown

    def place_target(self, place: Array, direction: Array | None = None) -> None:
        """Put the target at (3,) [m], with the tip to point along a unit vector (3,); None: as before."""
        self._target.put(place, direction)
        self._way = self.way_to_target()

    @property
    def target(self) -> Array:
        """Where the target is (3,) [m]."""
        return self._target.place

    @property
    def target_direction(self) -> Array | None:
        """Where the tip is to point there (3,); None: its direction is not controlled."""
        return None if self.pointing is None else self._target.direction

    def way_to_target(self) -> Way:
        """How the tip gets from where it is now to the target."""
        values = self._supervisor.status().values
        if not values:
            return Way(None, 0.0, "there is no telemetry yet")
        pointing = None
        if self.pointing is not None:
            # It sets out as the model has it, on which the way is tried; the tip turns by the little that is between.
            heading = self._modelled(values)
            if heading is None:
                return Way(None, 0.0, "where the tip points is not known now")
            pointing = Pointing(self._aim, heading, self._target.direction)
        return way_to(
            self._target.place, self._supervisor.statics, self._limits, values["joints"], values["tip_observed"],
            values["force_filtered"], pointing,
        )  # fmt: skip

    def _heading(self, values: Mapping[str, Array]) -> Array | None:
        """Where the tip points (3,), as observed or, while no controller looks at that, as the model has it."""
        if self.pointing is None:
            return None
        seen = values["direction_observed"]
        return seen if seen.any() and np.isfinite(seen).all() else self._modelled(values)

    def _modelled(self, values: Mapping[str, Array]) -> Array | None:
        """Where the model has the tip pointing (3,); None while joints and force do not tell it."""
        try:
            at = self._supervisor.statics.solve(values["joints"], pure_force(values["force_filtered"]))
        except CtrError:
            return None
        return at.rotation[:, 2]

    def close(self) -> None:
        """End the thread; the server is the caller's to stop."""
        self._end.set()
        self._thread.join()
        self._workspace.close()

    def _run(self) -> None:
        due, number = time.monotonic(), 0
        while not self._end.wait(max(0.0, due - time.monotonic())):
            try:
                if number % LOOK == 0:
                    self._look_for_contact()
                if number % UNWATCHED == 0 or self._server.get_clients():
                    self._frame(slow=number % SLOW == 0)
            except Exception:
                # Whatever it was, the next picture is a new chance; once a second is enough in the log.
                log.exception("a picture of the scene failed")
                self._end.wait(1.0)
            number += 1
            due = max(due + 1.0 / RATE, time.monotonic())

    def _look_for_contact(self) -> None:
        ring = self._supervisor.ring
        rows = ring.read(max(ring.written - ROWS, 0))[0]
        self._contact_monitor.look(rows if self._supervisor.status().age <= STALE else rows[:0])

    def _frame(self, *, slow: bool) -> None:
        status = self._supervisor.status()
        self._history.read(self._supervisor.ring)
        with self._server.atomic():
            self._scene.update(status, self._history, self.side_load())
            self._overlay(status)
            if slow:
                self._scene.update_trace(self._history)
                self._show_target()
                self._pull_by_hand(status)

    def _overlay(self, status: Status) -> None:
        values = status.values
        live = bool(values) and status.age <= STALE and bool(np.isfinite(values["joints"]).all())
        shown = self._shown if live else Shown()
        if live:
            uncertainty = math.sqrt(values["bias_covariance"][0])
            self._overlays.update(shown, values["joints"], values["tip_observed"], uncertainty)

    def _show_target(self) -> None:
        self._target.show(self._shown.target)
        if not self._shown.target:
            return
        if self._target.taken() is not None or self._way is None:
            self._way = self.way_to_target()

    def _pull_by_hand(self, status: Status) -> None:
        """The force's handle: dragged it pulls at the simulated tip, else it stays at the arrow's end."""
        shown = self._shown.force and bool(status.values) and self._supervisor.bench.devices is None
        self._hand.show(shown)
        if not shown:
            if self._pulls:
                self._pulls = False
                self._service.apply_load(NoLoad())
            return
        tip = status.values["tip_observed"]
        taken = self._hand.taken()
        if taken is not None:
            force = pull(taken, tip, ARROW)
            size = float(np.linalg.norm(force))
            self._pulls = True
            self._service.apply_load(ConstantLoad(magnitude=size, direction=_direction(force, size)))
        else:
            self._hand.put(tip + ARROW * self._history.mean("force"))


def _direction(force: Array, size: float) -> tuple[float, float, float]:
    """Of a force (3,) [N]; down when it has none."""
    x, y, z = (force / size).tolist() if size > 1e-6 else GRAVITY
    return x, y, z


def _no_share(verbose: bool = True) -> str | None:  # noqa: ARG001 - viser's signature
    log.warning("a client asked for a public share link; refused")
    return None
