"""A view on a live station."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import viser

from station.control_process import Bench
from station.desk import Desk
from station.experiments.experiment import ControllerFile
from station.lab.config import LabConfig
from station.robots import load_robot
from station.states import State
from station.supervisor import Supervisor
from web.view import View

READY_TIME = 60.0  # [s]


class Viewed(NamedTuple):
    """What a test looks at."""

    server: viser.ViserServer
    desk: Desk
    view: View

    @property
    def supervisor(self) -> Supervisor:
        return self.desk.supervisor

    def make_ready(self) -> None:
        if self.supervisor.status().state is State.RUNNING:
            self.supervisor.stop()
        if self.supervisor.status().state not in (State.READY, State.CONNECTED):
            self.supervisor.reset()
            wait_for(lambda: self.supervisor.status().state in (State.READY, State.CONNECTED))
        if self.supervisor.status().state is State.CONNECTED:
            self.supervisor.home()
        wait_for(lambda: self.supervisor.status().state is State.READY, 60.0)


@contextmanager
def viewing() -> Iterator[Viewed]:
    bench = Bench(load_robot("paper"), LabConfig(), 0, (0.0, np.pi / 2, -0.1), ControllerFile())
    supervisor = Supervisor(bench)
    failures = _Failures(logging.ERROR)
    logging.getLogger("web.view").addHandler(failures)
    try:
        supervisor.wait_ready(READY_TIME)
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        try:
            desk = Desk(supervisor)
            view = View(server, desk)
            try:
                yield Viewed(server, desk, view)
            finally:
                view.close()
        finally:
            server.stop()
    finally:
        supervisor.close()
        logging.getLogger("web.view").removeHandler(failures)
    assert failures.texts == []


class _Failures(logging.Handler):
    """Pictures that could not be drawn: the view goes on after them, a test does not."""

    def __init__(self, level: int) -> None:
        super().__init__(level)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(self.format(record))


def wait_for(condition: Callable[[], object], timeout: float = 20.0) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)
