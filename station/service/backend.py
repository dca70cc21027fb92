"""What stands behind the devices: a virtual lab's process, onto which a run brings load and faults, or a real bench."""

import threading
from collections.abc import Sequence

from station.config.strict import ConfigError
from station.control.process import ring_width
from station.control.ring import Ring
from station.devices.config import BenchFile
from station.lab.faults import LabFault
from station.lab.host import LabError, LabHost
from station.lab.loads import Load, NoLoad
from station.lab.process import LabBench
from station.service.bench import Bench
from station.service.own_bench import OwnBench
from station.service.start import Start


class Backend:
    """Owner of the lab's process, once it is opened; any thread may ask."""

    def __init__(self, bench: Bench, ring: Ring) -> None:
        self._bench, self._ring = bench, ring
        self._lock = threading.Lock()
        self._told: BenchFile | None = None
        self._motion_start: float | None = None
        self._brought: Start | None = None  # by the motion that is on
        self._host: LabHost | OwnBench | None = None

    def open(self) -> None:
        """Start a lab, or another one in the place of one that has died."""
        if self._host is not None:
            self._host.close()
        # Until the new one is there the old one answers: other threads ask meanwhile.
        self._host, self._told = self._start(), None

    @property
    def alive(self) -> bool:
        """Whether there is something behind the devices."""
        return self._host is not None and self._host.alive

    @property
    def pid(self) -> int | None:
        """Of the lab's process, while it lives."""
        return self._host.pid if isinstance(self._host, LabHost) and self._host.alive else None

    def devices(self) -> BenchFile:
        """What the control process has to open; waits for a lab that is coming up.

        Raises:
            LabError: it did not come up.
        """
        if self._told is None:
            if self._host is None:
                raise LabError("the lab was not started")
            self._told = self._host.devices()
        return self._told

    def apply_load(self, load: Load) -> None:
        """Put a load on the tip, now."""
        if self._host is not None:
            self._host.apply_load(load, self._bench.clock.now())

    def inject(self, faults: Sequence[LabFault]) -> None:
        """Let these faults happen from now on; none: clear all.

        Raises:
            ConfigError: a bench of one's own has faults of its own.
        """
        self.check(faults)
        if self._host is not None:
            self._host.inject(faults, self._bench.clock.now())

    def check(self, faults: Sequence[LabFault]) -> None:
        """Whether faults can be asked for here.

        Raises:
            ConfigError: a bench of one's own has faults of its own.
        """
        if faults and self._bench.devices is not None:
            raise ConfigError("faults can be injected into the virtual lab only; this station has devices of its own")

    def motion(self, start: Start | None, begun: float | None) -> None:
        """The motion of a start has begun at `begun` by the station's clock [s], or none is on any more (None)."""
        with self._lock:
            if begun == self._motion_start:
                return
            # What a run has brought goes with it: the next one may have been asked for already.
            ended, self._brought = self._brought, None if begun is None else start
            self._motion_start = begun
        if self._host is None:
            return
        if ended is not None and ended.load is not None:
            self._host.apply_load(NoLoad(), 0.0)
        if ended is not None and ended.faults:
            self._host.inject((), 0.0)
        if begun is not None and start is not None:
            if start.load is not None:
                self._host.apply_load(start.load, begun)
            if start.faults:
                self._host.inject(start.faults, begun)

    def close(self) -> None:
        """End the lab; a bench of one's own stays."""
        if self._host is not None:
            self._host.close()
            self._host = None

    def _start(self) -> LabHost | OwnBench:
        bench = self._bench
        if bench.devices is not None:
            return OwnBench(bench.devices)
        lab = LabBench(bench.robot, bench.lab, bench.seed, bench.park, bench.fifo, bench.terminals, bench.clock)
        return LabHost(lab, self._ring.name, ring_width(bench.robot))
