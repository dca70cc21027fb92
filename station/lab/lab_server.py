"""The virtual lab for other programs: its devices at real endpoints, in real time, until told to stop.

Stages and tracker are serial lines, reached by TCP or as pseudo-terminals; each force sensor is a box
on the network, with its datagrams by UDP and its page by HTTP. One loop carries all of it; no threads.
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
from station.control.clock import REAL_TIME, StationClock
from station.lab.config import LabConfig
from station.lab.loads import Load
from station.lab.netft.wire import AddressTaken, PageServer, UdpEnd
from station.lab.simulated_bench import SimulatedBench, Wires

HOST = "127.0.0.1"
PERIOD = 0.001  #: between two looks, unless bytes come earlier; about a byte at 9600 baud [s]
MOST_AT_ONCE = 1 << 16  #: taken from a line at one look [bytes]


class TcpEnd:
    """The device's end of a line that is reached by TCP. Like a port it is one program's at a time."""

    def __init__(self) -> None:
        self._server = socket.create_server((HOST, 0))
        self._server.setblocking(False)
        self._host: socket.socket | None = None
        self._port: int = self._server.getsockname()[1]
        self.name = f"socket://{HOST}:{self._port}"

    @property
    def files(self) -> list[int]:
        """What to wait for."""
        return [file for file in (self._server.fileno(), self._host.fileno() if self._host else -1) if file >= 0]

    def read(self) -> bytes:
        """What the host has written; nothing while there is none."""
        data = b""
        while self._host is not None:
            try:
                part = self._host.recv(MOST_AT_ONCE)
            except BlockingIOError:
                break
            except OSError:
                part = b""
            if not part:
                self._host.close()
                self._host = None
            data += part
            if len(data) >= MOST_AT_ONCE:
                return data  # the rest at the next look, and only then who comes next
        self._admit()
        return data

    def write(self, data: bytes) -> None:
        """Give `data` to the host; without one, or if it does not read, it is lost."""
        if self._host is not None:
            with contextlib.suppress(OSError):
                self._host.send(data)

    def unplug(self) -> None:
        """Pull the cable: the host is cut off, and nobody answers a new one."""
        self.close()

    def plug(self) -> None:
        """Put it back; raises AddressTaken when another program has the port meanwhile."""
        try:
            self._server = socket.create_server((HOST, self._port))
        except OSError as error:
            raise AddressTaken(f"{self.name} cannot be had again: {error.strerror}") from None
        self._server.setblocking(False)

    def close(self) -> None:
        """Let go of the port and of the host."""
        if self._host is not None:
            self._host.close()
            self._host = None
        self._server.close()

    def _admit(self) -> None:
        """Take the next host, or send it away while there is one already."""
        with contextlib.suppress(OSError):
            while True:
                visitor, _ = self._server.accept()
                if self._host is not None:
                    visitor.close()
                    continue
                visitor.setblocking(False)
                visitor.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # or the replies come in lumps
                self._host = visitor


class PtyEnd:
    """The device's end of a line that is reached as a pseudo-terminal."""

    def __init__(self, link: Path | None = None) -> None:
        """`link` is another name of it, which stays when the terminal comes back as another one."""
        self._link = link
        self._files: list[int] = []
        self.plug()
        self.name = str(link or os.ttyname(self._files[1]))

    @property
    def files(self) -> list[int]:
        """What to wait for."""
        return self._files[:1]

    def read(self) -> bytes:
        """What the host has written."""
        try:
            return os.read(self._files[0], MOST_AT_ONCE) if self._files else b""
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Give `data` to the host; what the terminal does not hold is lost."""
        with contextlib.suppress(BlockingIOError):
            if self._files:
                os.write(self._files[0], data)

    def unplug(self) -> None:
        """Pull the cable: the host's terminal is gone."""
        self.close()

    def plug(self) -> None:
        """Put it back: another terminal, as an adapter may come back under another name."""
        import tty  # not on Windows

        # The host's side is kept open, or the line would hang up when a host leaves.
        self._files = list(os.openpty())
        tty.setraw(self._files[1])
        os.set_blocking(self._files[0], False)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(os.ttyname(self._files[1]))

    def close(self) -> None:
        """Let go of the terminal."""
        while self._files:
            os.close(self._files.pop())


class LabServer:
    """A `SimulatedBench` whose devices can be reached. Use it as a context."""

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
        clock: StationClock = REAL_TIME,
    ) -> None:
        """`pty`: terminals instead of TCP; `netft_port`: UDP port of the first box, the others follow; 0: any.

        `homed`: the stages have been left on since they were homed. `folder`: terminals are told by links
        in there, which stay when a terminal comes back as another one. `clock`: whose time the devices keep.

        Raises:
            AddressTaken: a given port is another program's.
            PoseError, NoSolution: the true robot cannot stand at `positions` (n,).
        """
        with contextlib.ExitStack() as opened:

            def line(name: str) -> PtyEnd | TcpEnd:
                return PtyEnd(None if folder is None else folder / name) if pty else TcpEnd()

            self._lines = (line("zaber"), line("aurora"))
            for end in self._lines:
                opened.callback(end.close)
            boxes: list[UdpEnd] = []
            for number in range(len(robot.tubes)):
                boxes.append(UdpEnd(HOST, netft_port + number if netft_port else 0))
                opened.callback(boxes[-1].close)
            self.lab = SimulatedBench(robot, config, seed, positions, Wires(*self._lines, tuple(boxes)), homed)
            self._pages: list[PageServer] = []
            for box in self.lab.boxes:
                self._pages.append(PageServer(HOST, 0, box.page))
                opened.callback(self._pages[-1].close)
            self._opened = opened.pop_all()
        self.clock = clock
        self.begun = clock.now()  #: when the lab's time was 0
        #: Where everything is: what `ctr-station lab` prints.
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
        """Let go of every endpoint."""
        self._opened.close()

    def run(self, stopped: Callable[[], bool]) -> None:
        """Keep the clock's time until `stopped`, which is asked at every look.

        A robot that cannot follow its stages is reported on stderr.
        """
        clock, start, due, trouble = self.clock, self.begun, 0.0, ""
        while not stopped():
            files = [file for line in self._lines for file in line.files]
            select.select(files, [], [], clock.real(max(0.0, start + due - clock.now())))
            now = clock.now() - start
            self.lab.advance(now)
            if self.lab.trouble and not trouble:
                sys.stderr.write(f"the robot stays where it is: {' '.join(self.lab.trouble.split())}\n")
            trouble = self.lab.trouble
            if now >= due:
                for page in self._pages:
                    page.poll()
                # The deadlines are absolute; those that have been missed are left out.
                due = (math.floor(now / PERIOD) + 1) * PERIOD


def serve(lab: LabServer, load: Load, ready: Callable[[dict[str, Any]], None]) -> None:
    """Run the lab with a load on the tip until SIGINT or SIGTERM; `ready` is told the endpoints."""
    lab.lab.apply_load(load, 0.0)
    with _signals() as received, lab:
        ready(lab.endpoints)
        lab.run(lambda: bool(received))


@contextlib.contextmanager
def _signals() -> Iterator[list[int]]:
    """Signals to end, as a list of those that have come."""
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
