"""The viser view of the station: one thread that keeps scene and panel up to date."""

import logging
import threading
import time

import viser

from station.desk import Desk
from web.history import History
from web.panel import Panel
from web.scene import Scene

#: Pictures a second; plots, trace and texts come with every third.
RATE = 30.0
SLOW = 3

log = logging.getLogger(__name__)


class View:
    """Scene and panel on a viser server of the caller's, until closed."""

    def __init__(self, server: viser.ViserServer, desk: Desk) -> None:
        self._server = server
        self._supervisor = desk.supervisor
        # A client may ask for a public tunnel to this server: there is none.
        server.request_share_url = _no_share
        self._history = History(desk.supervisor.channels)
        self._scene = Scene(server, desk.supervisor)
        self._panel = Panel(server, desk)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="viser view")
        self._thread.start()

    def close(self) -> None:
        """End the thread; the server is the caller's to stop."""
        self._end.set()
        self._thread.join()

    def _run(self) -> None:
        due, number = time.monotonic(), 0
        while not self._end.wait(max(0.0, due - time.monotonic())):
            try:
                self._frame(slow=number % SLOW == 0)
            except Exception:
                # Whatever it was, the next picture is a new chance; once a second is enough in the log.
                log.exception("a picture of the scene failed")
                self._end.wait(1.0)
            number += 1
            due = max(due + 1.0 / RATE, time.monotonic())

    def _frame(self, *, slow: bool) -> None:
        status = self._supervisor.status()
        self._history.read(self._supervisor.ring, status.phase)
        with self._server.atomic():
            self._scene.update(status, self._history)
            if slow:
                self._scene.update_trace(self._history)
                self._panel.update(status, self._history)


def _no_share(verbose: bool = True) -> str | None:  # noqa: ARG001 - viser's signature
    log.warning("a client asked for a public share link; refused")
    return None
