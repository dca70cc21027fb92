"""The process of the live virtual lab, which runs independently of the controller, like a real bench.

The lab's process continues after the end of the control process, and for 10 s after that of the station process, so
that the simulated stages still receive their stop commands. It receives bytes on the simulated wires. Through a pipe it
receives loads and faults from the station process.
"""

import contextlib
import os
import signal
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from core.errors import CtrError
from station.config.loads import Load
from station.config.robots import RobotFile
from station.control.child_process import ChildProcess
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.control.realtime import set_process_name
from station.control.ring import LAB_HEARTBEAT, SHAPE_PORT, Ring
from station.devices.config import BenchFile
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.lab_server import LabServer, be_punctual, devices_at

#: Time for which the lab continues after the end of the station process [s].
OUTLIVE_STATION_S = 10.0


class SetForce(NamedTuple):
    """Message of the station process to the lab: apply a load to the tip."""

    load: Load
    start: float  #: time of the station's clock at which the load starts [s]


class InjectFaults(NamedTuple):
    """Message of the station process to the lab: replace all active and planned faults."""

    faults: tuple[LabFault, ...]
    start: float  #: time of the station's clock from which the faults' times count [s]


class LabBench(NamedTuple):
    """Configuration of the lab's process."""

    robot: RobotFile
    config: LabConfig
    seed: int
    park: tuple[float, ...]  #: joint positions at power-up [rad or m]
    fifo: bool = True  #: whether to request real-time scheduling
    terminals: Path | None = None  #: folder for the links to pseudo-terminals; None: serial lines by TCP
    clock: StationClock = REAL_TIME_CLOCK
    shape: bool = False  #: whether to give the true shape to simulated cameras


def run_lab(bench: LabBench, ring_name: str, width: int, pipe: Connection, parent: int) -> None:
    """Main function of the lab's process.

    It sends the endpoints of its devices to the station process, or the reason why it has not started.
    """
    # A service manager's SIGTERM reaches all processes of the station, but the lab must outlive the other processes,
    # which wait for the stages to stop.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    set_process_name("ctr-lab")
    ring = Ring(width, ring_name)
    try:
        # Use pseudo-terminals only on request: a kernel thread of normal priority transfers their bytes. On a busy
        # computer, the control loop would wait for milliseconds for a lock of this thread.
        pty, park = bench.terminals is not None, np.array(bench.park)
        lab = LabServer(
            bench.robot, bench.config, bench.seed, park, pty,
            homed=True, folder=bench.terminals, clock=bench.clock, shape=bench.shape,
        )  # fmt: skip
    except CtrError as error:
        pipe.send(str(error))
        return
    lab.lab.advance(bench.clock.now() - lab.start_time)  # loads and compiles code before clients wait for the lab
    if lab.shape is not None:
        lab.lab.shape()
        ring.numbers[SHAPE_PORT] = lab.shape.port
    be_punctual(bench.fifo)
    with lab:
        pipe.send(lab.endpoints)
        lab.run(_LabClient(lab, ring, pipe, parent).poll, (pipe.fileno(),))
    ring.close(remove=os.getppid() != parent)


class _LabClient:
    """Polls the pipe from the station process and publishes the ground truth in each cycle of the lab."""

    def __init__(self, lab: LabServer, ring: Ring, pipe: Connection, parent: int) -> None:
        self._lab, self._ring, self._pipe, self._parent = lab, ring, pipe, parent
        self._orphaned_since = 0.0

    def poll(self) -> bool:
        """Process the station's messages; return whether the lab has to end."""
        self._ring.publish_ground_truth(self._lab.lab.truth, bool(self._lab.lab.trouble))
        self._ring.numbers[LAB_HEARTBEAT] = self._lab.clock.now()
        if self._orphaned_since or os.getppid() != self._parent:
            self._orphaned_since = self._orphaned_since or self._lab.clock.now()
            return self._lab.clock.now() - self._orphaned_since > OUTLIVE_STATION_S
        with contextlib.suppress(EOFError, OSError):
            while self._pipe.fileno() in self._lab.readable and self._pipe.poll():
                message: SetForce | InjectFaults | None = self._pipe.recv()
                if message is None:
                    return True
                start = message.start - self._lab.start_time
                if isinstance(message, SetForce):
                    self._lab.lab.apply_load(message.load, start)
                else:
                    self._lab.lab.inject(message.faults, start)
            return False
        self._orphaned_since = self._lab.clock.now()
        return False


class LabError(CtrError):
    """The live virtual lab did not start."""


class LabHost:
    """Owner of the process of the live virtual lab."""

    def __init__(self, bench: LabBench, ring_name: str, width: int) -> None:
        self._config, self._clock = bench.config, bench.clock
        # The lab must outlive this process by a few seconds, so that the stages still receive their stop.
        self._child = ChildProcess(run_lab, bench, ring_name, width, name="lab", daemon=False)

    @property
    def alive(self) -> bool:
        """Whether the lab's process runs."""
        return self._child.alive

    @property
    def pid(self) -> int:
        """Process ID of the lab."""
        return self._child.pid

    def devices(self) -> BenchFile:
        """Wait for the lab, and return the devices that the control process has to open.

        Raises:
            LabError: the lab did not start.
        """
        try:
            endpoints: Mapping[str, Any] | str = self._child.pipe.recv()
        except (EOFError, OSError):
            raise LabError("the virtual lab ended before its devices were ready") from None
        if isinstance(endpoints, str):
            raise LabError(f"the virtual lab did not start: {endpoints}")
        return devices_at(endpoints, self._config, self._clock)

    def apply_load(self, load: Load, start: float) -> None:
        """Apply a load that starts at `start` of the station's clock [s] to the tip. An ended lab ignores it."""
        self._child.send(SetForce(load, start))

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Replace all active and planned faults; their times count from `start` of the station's clock [s]."""
        self._child.send(InjectFaults(tuple(faults), start))

    def close(self) -> None:
        """End the lab."""
        self._child.close(2.0)
