"""Backend that provides the devices: the process of a virtual lab, which applies loads and faults, or real hardware."""

import threading
from collections.abc import Sequence

from station.config.loads import Load, NoLoad
from station.config.strict import ConfigError
from station.control.process import ring_width
from station.control.ring import Ring
from station.devices.config import BenchFile
from station.lab.faults import LabFault
from station.lab.process import LabBench, LabError, LabHost
from station.service.hardware_rig import HardwareRig
from station.service.rig import Rig
from station.service.run_request import StartRequest


class Backend:
    """Owner of the virtual lab's process, or access to real hardware; its methods are thread-safe."""

    def __init__(self, bench: Rig, ring: Ring) -> None:
        self._bench, self._ring = bench, ring
        self._lock = threading.Lock()
        self._devices: BenchFile | None = None
        self._motion_start: float | None = None
        self._applied: StartRequest | None = None  # start request whose load and faults are applied now
        self._host: LabHost | HardwareRig | None = None

    def open(self) -> None:
        """Start the lab, or replace a lab that has died."""
        if self._host is not None:
            self._host.close()
        # Other threads use the old host until the new one is assigned.
        self._host, self._devices = self._start(), None

    @property
    def alive(self) -> bool:
        """Whether the lab's process runs; always true for real hardware."""
        return self._host is not None and self._host.alive

    @property
    def pid(self) -> int | None:
        """Process ID of the lab while it runs; None for real hardware."""
        return self._host.pid if isinstance(self._host, LabHost) and self._host.alive else None

    def devices(self) -> BenchFile:
        """Return the devices that the control process has to open; wait for a lab that is starting.

        Raises:
            LabError: the lab did not start.
        """
        if self._devices is None:
            if self._host is None:
                raise LabError("the lab was not started")
            self._devices = self._host.devices()
        return self._devices

    def apply_load(self, load: Load) -> None:
        """Apply a load to the tip of the virtual lab's robot now."""
        if self._host is not None:
            self._host.apply_load(load, self._bench.clock.now())

    def inject(self, faults: Sequence[LabFault]) -> None:
        """Inject faults into the simulated devices from now on; an empty sequence clears all faults.

        Raises:
            ConfigError: the devices are real.
        """
        self.check(faults)
        if self._host is not None:
            self._host.inject(faults, self._bench.clock.now())

    def check(self, faults: Sequence[LabFault]) -> None:
        """Check that the faults can be injected into the devices of this station.

        Raises:
            ConfigError: the devices are real.
        """
        if faults and self._bench.devices is not None:
            raise ConfigError("faults can be injected into the virtual lab only; this station has real devices")

    def motion(self, start: StartRequest | None, motion_start: float | None) -> None:
        """Apply the load and faults of a run whose motion started at `motion_start`, by the station's clock [s].

        With `motion_start` None the motion has ended, so its load and faults are cleared.
        """
        with self._lock:
            if motion_start == self._motion_start:
                return
            # Clear the load and faults of the ended run; the next run may already have been requested.
            ended, self._applied = self._applied, None if motion_start is None else start
            self._motion_start = motion_start
        if self._host is None:
            return
        if ended is not None and ended.load is not None:
            self._host.apply_load(NoLoad(), 0.0)
        if ended is not None and ended.faults:
            self._host.inject((), 0.0)
        if motion_start is not None and start is not None:
            if start.load is not None:
                self._host.apply_load(start.load, motion_start)
            if start.faults:
                self._host.inject(start.faults, motion_start)

    def close(self) -> None:
        """End the lab's process; with real hardware do nothing."""
        if self._host is not None:
            self._host.close()
            self._host = None

    def _start(self) -> LabHost | HardwareRig:
        bench = self._bench
        if bench.devices is not None:
            return HardwareRig(bench.devices)
        lab = LabBench(bench.robot, bench.lab, bench.seed, bench.park, bench.fifo, bench.terminals, bench.clock)
        return LabHost(lab, self._ring.name, ring_width(bench.robot))
