"""Serves the virtual lab to other programs: the simulated devices have real endpoints and run in real time.

Stages and tracker have serial lines, which are TCP connections or pseudo-terminals. Each force sensor is a box on the
network, which sends datagrams by UDP and its configuration page by HTTP. One loop serves all devices without threads.
"""

import contextlib
import math
import os
import select
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self

from core.robot.robot import Array
from station.config.robots import RobotFile
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.control.realtime import freeze_garbage_collection, request_fifo
from station.lab.config import LabConfig
from station.lab.loads import Load
from station.lab.netft.wire import AddressInUse, PageServer, UdpDeviceEnd
from station.lab.simulated_bench import SimulatedBench, Wires

if sys.platform != "win32":
    import fcntl
    import termios
    import tty

HOST = "127.0.0.1"
PERIOD_S = 0.001  #: longest time between two polls of the devices; about the duration of a byte at 9600 baud [s]
#: Largest number of bytes read from a line at one poll, which is the size of a serial port's buffer. Further bytes wait
#: in the operating system's buffers.
MAX_READ_BYTES = 4096
#: Connections accepted at one poll; others wait, so that a flood of connections does not delay the devices.
MAX_VISITORS = 16
#: Real-time priority of the lab: below the control loop's, so that the loop is never late because of it.
PRIORITY = 40


class TcpDeviceEnd:
    """The device's end of a serial line by TCP. Like a serial port it serves one program at a time."""

    def __init__(self) -> None:
        self._server = socket.create_server((HOST, 0))
        self._server.setblocking(False)
        self._host: socket.socket | None = None
        self._port: int = self._server.getsockname()[1]
        self.name = f"socket://{HOST}:{self._port}"

    @property
    def files(self) -> list[int]:
        """Return the file descriptors whose data the server waits for."""
        return [file for file in (self._server.fileno(), self._host.fileno() if self._host else -1) if file >= 0]

    def read(self) -> bytes:
        """Return the bytes that the host has written; empty without a host."""
        data = b""
        while self._host is not None:
            try:
                part = self._host.recv(MAX_READ_BYTES - len(data))
            except BlockingIOError:
                break
            except OSError:
                part = b""
            if not part:
                self._host.close()
                self._host = None
            data += part
            if len(data) >= MAX_READ_BYTES:
                return data  # read the remaining bytes at the next poll, and accept the next host only then
        self._admit()
        return data

    def write(self, data: bytes) -> None:
        """Send `data` to the host; it is lost without a host, or if the host does not read."""
        if self._host is not None:
            with contextlib.suppress(OSError):
                self._host.send(data)

    def unplug(self) -> None:
        """Pull the cable: the host is disconnected, and new connections are refused."""
        self.close()

    def plug(self) -> None:
        """Plug the cable in again; raises AddressInUse when another program has the port meanwhile."""
        try:
            self._server = socket.create_server((HOST, self._port))
        except OSError as error:
            raise AddressInUse(f"{self.name} is not available again: {error.strerror}") from None
        self._server.setblocking(False)

    def close(self) -> None:
        """Close the port and the connection."""
        if self._host is not None:
            self._host.close()
            self._host = None
        self._server.close()

    def _admit(self) -> None:
        """Accept the connection of the next host; close it if another host is connected already."""
        with contextlib.suppress(OSError):
            for _ in range(MAX_VISITORS):
                visitor, _ = self._server.accept()
                if self._host is not None:
                    visitor.close()
                    continue
                visitor.setblocking(False)
                visitor.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # prevents that replies come in batches
                self._host = visitor


class PtyDeviceEnd:
    """The device's end of a serial line by pseudo-terminal.

    A kernel thread of normal priority carries the bytes. `select` and a read of an empty terminal wait for that thread,
    for tens of milliseconds on a busy computer. So the lab only queries how many bytes have arrived.
    """

    def __init__(self, link: Path | None = None) -> None:
        """`link` is a symbolic link to the terminal, which stays valid when the terminal changes."""
        self._link = link
        self._files: list[int] = []
        self.plug()
        self.name = str(link or os.ttyname(self._files[1]))

    @property
    def files(self) -> list[int]:
        """Return no file descriptors to wait for, because the terminal is polled."""
        return []

    def read(self) -> bytes:
        """Return the bytes that the host has written."""
        if not self._files:
            return b""
        arrived = int.from_bytes(fcntl.ioctl(self._files[0], termios.FIONREAD, bytes(4)), sys.byteorder)
        return os.read(self._files[0], MAX_READ_BYTES) if arrived else b""

    def write(self, data: bytes) -> None:
        """Send `data` to the host; bytes beyond the terminal's buffer are lost."""
        with contextlib.suppress(BlockingIOError):
            if self._files:
                os.write(self._files[0], data)

    def unplug(self) -> None:
        """Pull the cable: the host's terminal disappears."""
        self.close()

    def plug(self) -> None:
        """Plug the cable in again: open a new terminal, whose name may differ as that of a real USB adapter may."""
        # Keep the host's side open, because the line would hang up when a host closes it.
        self._files = list(os.openpty())
        tty.setraw(self._files[1])
        os.set_blocking(self._files[0], False)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(os.ttyname(self._files[1]))

    def close(self) -> None:
        """Close the terminal."""
        while self._files:
            os.close(self._files.pop())


class LabServer:
    """A `SimulatedBench` with devices at real endpoints. Use it as a context manager."""

    def __init__(
        self,
        robot: RobotFile,
        config: LabConfig,
        seed: int,
        positions: Array,
        pty: bool = False,
        netft_port: int = 0,
        homed: bool = False,
        folder: Path | None = None,
        clock: StationClock = REAL_TIME_CLOCK,
    ) -> None:
        """Create the endpoints, and the bench with the joints at `positions` (n,).

        `pty`: terminals instead of TCP. `netft_port`: UDP port of the first box, the others follow; 0: any.
        `homed`: the stages are homed. `folder`: for symbolic links to the terminals, which stay valid when a terminal
        changes. `clock`: time of the devices.

        Raises:
            AddressInUse: another program has a given port.
            PoseError, NoSolution: the plant (simulated real robot) has no equilibrium shape at `positions`.
        """
        with contextlib.ExitStack() as opened:

            def line(name: str) -> PtyDeviceEnd | TcpDeviceEnd:
                return PtyDeviceEnd(None if folder is None else folder / name) if pty else TcpDeviceEnd()

            self._lines = (line("zaber"), line("aurora"))
            for end in self._lines:
                opened.callback(end.close)
            boxes: list[UdpDeviceEnd] = []
            for number in range(len(robot.tubes)):
                boxes.append(UdpDeviceEnd(HOST, netft_port + number if netft_port else 0))
                opened.callback(boxes[-1].close)
            self.lab = SimulatedBench(robot, config, seed, positions, Wires(*self._lines, tuple(boxes)), homed)
            self._pages: list[PageServer] = []
            for box in self.lab.boxes:
                self._pages.append(PageServer(HOST, 0, box.page))
                opened.callback(self._pages[-1].close)
            self._opened = opened.pop_all()
        self.clock = clock
        self.start_time = clock.now()  #: time of the clock at the lab's time 0 [s]
        #: Endpoints of the devices, as `ctr-station lab` prints them.
        self.endpoints: dict[str, Any] = {
            "zaber": self._lines[0].name,
            "aurora": self._lines[1].name,
            "netft": [
                {
                    "tube": tube.name,
                    "rdt": f"udp://{HOST}:{box.port}",
                    "page": f"http://{HOST}:{page.port}/netftapi2.xml",
                }
                for tube, box, page in zip(robot.tubes, boxes, self._pages, strict=True)
            ],
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all endpoints."""
        self._opened.close()

    def run(self, stopped: Callable[[], bool]) -> None:
        """Run the lab in the clock's time until `stopped` returns true; it is called in each cycle.

        A robot that cannot follow its stages is reported on stderr.
        """
        clock, start, due, early, trouble = self.clock, self.start_time, 0.0, False, ""
        while not stopped():
            wait = max(0.0, start + due - clock.now())
            if early:  # sleep for the rest of the period, because a flood of bytes must not use a whole processor
                clock.sleep(wait)
            else:
                select.select([file for line in self._lines for file in line.files], [], [], clock.real(wait))
            now = clock.now() - start
            early = now < due
            self.lab.advance(now)
            if self.lab.trouble and not trouble:
                sys.stderr.write(f"the robot stays where it is: {' '.join(self.lab.trouble.split())}\n")
            trouble = self.lab.trouble
            if now >= due:
                for page in self._pages:
                    page.poll()
                # The deadlines are absolute, so delays do not add up; missed deadlines are skipped.
                due = (math.floor(now / PERIOD_S) + 1) * PERIOD_S


def be_punctual(fifo: bool) -> bool:
    """Prepare the calling process for simulated devices on a busy computer; real devices have separate processors.

    Args:
        fifo: request real-time scheduling.

    Returns:
        False when the system refuses real-time scheduling.
    """
    freeze_garbage_collection()
    # Round robin, because the labs of two stations may share a processor.
    return not fifo or request_fifo(PRIORITY, in_turns=True)


def serve(lab: LabServer, load: Load, ready: Callable[[dict[str, Any]], None], fifo: bool = True) -> None:
    """Run the lab with a load on the tip until SIGINT or SIGTERM; `ready` receives the endpoints.

    `fifo`: request real-time scheduling.
    """
    lab.lab.apply_load(load, 0.0)
    with _signals() as received, lab:
        lab.lab.advance(lab.clock.now() - lab.start_time)  # compiles the code before the first tick of `run`
        if not be_punctual(fifo):
            sys.stderr.write(
                "real-time scheduling is refused: on a busy computer the simulated devices may answer too late;"
                " ctr-station doctor explains how to enable it\n"
            )
        ready(lab.endpoints)
        lab.run(lambda: bool(received))


@contextlib.contextmanager
def _signals() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM in a list."""
    received: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: received.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield received
    finally:
        for number, action in before.items():
            signal.signal(number, action)
