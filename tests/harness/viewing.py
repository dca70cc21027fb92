"""A view of the 3D scene on a live station, without a web server."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import viser

from station.control.states import State
from station.service.commands import Home
from station.service.station_file import load_station
from station.service.supervisor import Supervisor
from tests.harness.calm import SETTINGS
from tests.harness.waiting import NET, until
from web.scene.view import SceneView


class Viewed(NamedTuple):
    """A live station and its view."""

    server: viser.ViserServer
    supervisor: Supervisor
    view: SceneView

    def make_ready(self) -> None:
        until(lambda: self.supervisor.status().state is not State.HOMED)  # the controller is starting
        if self.supervisor.status().state is State.RUNNING:
            self.supervisor.stop()
        if self.supervisor.status().state not in (State.READY, State.CONNECTED):
            self.supervisor.reset()
            until(lambda: self.supervisor.status().state in (State.READY, State.CONNECTED))
        if self.supervisor.status().state is State.CONNECTED:
            self.supervisor.send(Home(way_is_clear=True, then_working_pose=False))
        until(lambda: self.supervisor.status().state is State.READY)


@contextmanager
def viewing() -> Iterator[Viewed]:
    bench = load_station(None, SETTINGS).bench()
    supervisor = Supervisor(bench)
    failures = _Failures(logging.ERROR)
    logging.getLogger("web.scene.view").addHandler(failures)
    try:
        supervisor.open()
        supervisor.wait_ready(NET)
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            view = SceneView(server, supervisor)
            try:
                yield Viewed(server, supervisor, view)
            finally:
                view.close()
        finally:
            server.stop()
    finally:
        supervisor.close()
        logging.getLogger("web.scene.view").removeHandler(failures)
    assert failures.texts == []


class _Failures(logging.Handler):
    """Log handler that collects the errors of failed drawings, because the view continues after such an error."""

    def __init__(self, level: int) -> None:
        super().__init__(level)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(self.format(record))
