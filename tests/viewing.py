"""A view on a live station, and a browser that says whatever it likes."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from websockets.sync.client import ClientConnection, connect

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
        if self.supervisor.status().state is not State.READY:
            self.supervisor.reset()
        wait_for(lambda: self.supervisor.status().state is State.READY)


@contextmanager
def viewing() -> Iterator[Viewed]:
    bench = Bench(load_robot("paper"), LabConfig(), 0, (0.0, np.pi / 2, -0.1), ControllerFile(), fifo=False)
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


class Browser:
    """A viser client that draws nothing and obeys no slider."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket
        self.send(
            "ViewerCameraMessage", wxyz=(1, 0, 0, 0), position=(0, 0, 1), fov=1.0, near=0.1, far=10.0,
            image_height=100, image_width=100, look_at=(0, 0, 0), up_direction=(0, 0, 1),
        )  # fmt: skip

    def send(self, kind: str, **fields: Any) -> None:
        self._socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def set(self, widget: Any, value: Any) -> None:
        self.send("GuiUpdateMessage", uuid=widget._impl.uuid, updates={"value": value})

    def press(self, button: Any) -> None:
        self.set(button, True)

    def message(self, kind: str, timeout: float = 5.0) -> dict[str, Any]:
        """The next message of that kind."""
        deadline = time.monotonic() + timeout
        while True:
            data = self._socket.recv(timeout=deadline - time.monotonic())
            assert isinstance(data, bytes)
            packed = data[16 : 16 + int.from_bytes(data[8:16], "little")]
            window = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packed))
            for message in window["messages"]:
                if message["type"] == kind:
                    return message

    def refusal(self) -> str:
        """Text of the next notification."""
        return self.message("NotificationShowMessage")["props"]["body"]


@contextmanager
def browser(server: viser.ViserServer) -> Iterator[Browser]:
    protocol: Any = f"viser-v{viser.__version__}"
    with connect(
        f"ws://127.0.0.1:{server.get_port()}", subprotocols=[protocol], max_size=None, close_timeout=0.2
    ) as socket:
        yield Browser(socket)


def wait_for(condition: Callable[[], object], timeout: float = 10.0) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)
