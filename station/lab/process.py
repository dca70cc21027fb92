"""The live virtual lab: a process of its own, like a bench that stands there whoever controls it.

It outlives the control process, and for a while the station process too: long enough for the stops of
either to arrive. What it hears besides the bytes on its wires comes through a pipe from the station.
"""

import contextlib
import os
import signal
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from core.errors import CtrError
from station.config.robots import RobotFile
from station.control.clock import REAL_TIME, StationClock
from station.control.realtime import ask_for_fifo, keep_memory, show_as
from station.control.ring import LAB_HEARTBEAT, Ring
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.lab_server import LabServer
from station.lab.loads import Load

#: The lab goes on for so long when the station process has gone [s].
OUTLIVES = 10.0
#: Below the control loop's.
PRIORITY = 40


class Pull(NamedTuple):
    """Station process -> lab: put a load on the tip."""

    load: Load
    start: float  #: by the station's clock when its time is 0 [s]


class Inject(NamedTuple):
    """Station process -> lab: these faults, instead of those that are on or to come."""

    faults: tuple[LabFault, ...]
    start: float  #: by the station's clock when their time is 0 [s]


class Opened(NamedTuple):
    """Lab -> station process: where the devices are, or why there are none."""

    endpoints: Mapping[str, Any]
    problem: str


class LabBench(NamedTuple):
    """What is in the lab."""

    robot: RobotFile
    config: LabConfig
    seed: int
    park: tuple[float, ...]  #: joints at power-up [rad or m]
    fifo: bool = True  #: ask for real-time scheduling
    terminals: Path | None = None  #: folder for pseudo-terminals instead of TCP
    clock: StationClock = REAL_TIME


def run_lab(bench: LabBench, ring_name: str, width: int, pipe: Connection, parent: int) -> None:
    """Main function of the lab's process."""
    # The station process decides when it ends: a terminal's Ctrl-C reaches the whole group, a service manager's SIGTERM
    # too, and the stages are seen to stop by those who end last.
    for ending in (signal.SIGINT, signal.SIGTERM):
        signal.signal(ending, signal.SIG_IGN)
    show_as("ctr-lab")
    ring = Ring(width, ring_name)
    try:
        # No pseudo-terminals unless asked for: the kernel carries their bytes in a thread of normal priority, behind
        # whose locks the control loop would wait for milliseconds on a busy computer.
        pty, park = bench.terminals is not None, np.array(bench.park)
        lab = LabServer(
            bench.robot, bench.config, bench.seed, park, pty, homed=True, folder=bench.terminals, clock=bench.clock
        )
    except CtrError as error:
        pipe.send(Opened({}, str(error)))
        return
    lab.lab.advance(bench.clock.now() - lab.begun)  # what is loaded or compiled for it keeps nobody else waiting
    # Real devices have processors of their own: a busy computer must not make the simulated ones late. The labs of two
    # stations share a processor, though.
    keep_memory()
    if bench.fifo:
        ask_for_fifo(PRIORITY, in_turns=True)
    with lab:
        pipe.send(Opened(lab.endpoints, ""))
        lab.run(_Visitor(lab, ring, pipe, parent).look)
    ring.close(remove=os.getppid() != parent)


class _Visitor:
    """Looks at the pipe and tells the truth, at every turn of the lab."""

    def __init__(self, lab: LabServer, ring: Ring, pipe: Connection, parent: int) -> None:
        self._lab, self._ring, self._pipe, self._parent = lab, ring, pipe, parent
        self._alone_since = 0.0

    def look(self) -> bool:
        """True when the lab is to end."""
        self._ring.publish_ground_truth(self._lab.lab.truth, bool(self._lab.lab.trouble))
        self._ring.numbers[LAB_HEARTBEAT] = self._lab.clock.now()
        if self._alone_since or os.getppid() != self._parent:
            self._alone_since = self._alone_since or self._lab.clock.now()
            return self._lab.clock.now() - self._alone_since > OUTLIVES
        with contextlib.suppress(EOFError, OSError):
            while self._pipe.poll():
                message: Pull | Inject | None = self._pipe.recv()
                if message is None:
                    return True
                start = message.start - self._lab.begun
                if isinstance(message, Pull):
                    self._lab.lab.apply_load(message.load, start)
                else:
                    self._lab.lab.inject(message.faults, start)
            return False
        self._alone_since = self._lab.clock.now()
        return False
