"""The Aurora driver and the simulated unit over pseudo-terminals and sockets, in real time."""

import os
import socket
import termios
import threading
import time
import tty

import numpy as np
import pytest

from station.devices.aurora_tracker import AuroraTracker
from station.devices.links import LinkError, SerialLink
from station.lab.aurora_wire import pump
from station.lab.config import TrackerConfig
from station.lab.simulated_aurora import SimulatedAurora
from station.lab.simulated_aurora_coil import MOUNT
from tests.harness.aurora_bench import REST


class PtyEnd:
    """The device's end of a pty, which tells the host's rate."""

    def __init__(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, False)
        self.name = os.ttyname(self.slave)

    @property
    def host_baud(self) -> int | None:
        rates = {termios.B9600: 9600, termios.B115200: 115200}
        return rates.get(termios.tcgetattr(self.slave)[4])

    def read(self) -> bytes:
        try:
            return os.read(self.master, 65536)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        os.write(self.master, data)

    def close(self) -> None:
        os.close(self.master)
        os.close(self.slave)


class SocketEnd:
    """The device's end of a TCP connection."""

    def __init__(self) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.setblocking(False)
        self._socket: socket.socket | None = None
        self.name = f"socket://127.0.0.1:{self._server.getsockname()[1]}"

    def read(self) -> bytes:
        try:
            if self._socket is None:
                self._socket, _ = self._server.accept()
                self._socket.setblocking(False)
            return self._socket.recv(65536)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise LinkError(f"{self.name} is gone: {error}") from None

    def write(self, data: bytes) -> None:
        assert self._socket is not None
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkError(f"{self.name} is gone: {error}") from None

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._server.close()


@pytest.mark.parametrize("kind", [PtyEnd, SocketEnd])
def test_the_same_driver_and_unit_meet_over_ptys_and_sockets(kind):
    end = kind()
    unit = SimulatedAurora(TrackerConfig(noise=0.0), np.random.default_rng(0))
    over = threading.Event()
    begin = time.monotonic()

    def serve() -> None:
        last = 0.0
        while not over.is_set():
            now = time.monotonic() - begin
            unit.advance(last, now, REST, REST)
            last = now
            pump(end, unit, now)
            time.sleep(0.001)

    server = threading.Thread(target=serve)
    server.start()
    tracker = AuroraTracker(SerialLink(end.name, 9600), registration=MOUNT)
    read = []
    try:
        while len(read) < 20 and time.monotonic() - begin < 60.0:
            reading = tracker.poll(time.monotonic() - begin)
            if reading is not None:
                read.append(reading)
            time.sleep(0.001)
    finally:
        tracker.close()
        over.set()
        server.join()
        end.close()

    assert len(read) == 20
    assert unit.baud == 115200
    for reading in read:
        assert reading.position == pytest.approx(REST, abs=1e-8)
