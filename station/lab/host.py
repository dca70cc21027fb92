"""The station process's side of the live virtual lab: it starts the lab's process and sends it commands."""

from collections.abc import Sequence

from core.errors import CtrError
from station.control.child_process import ChildProcess
from station.devices.config import BenchFile
from station.lab.endpoints import devices_at
from station.lab.faults import LabFault
from station.lab.loads import Load
from station.lab.process import InjectFaults, LabBench, LabConnection, SetForce, run_lab


class LabError(CtrError):
    """A live virtual lab that does not start."""


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
        """Number of the lab's process."""
        return self._child.pid

    def devices(self) -> BenchFile:
        """Wait for the lab, and return the devices that the control process has to open.

        Raises:
            LabError: the lab did not start.
        """
        try:
            opened: LabConnection = self._child.pipe.recv()
        except (EOFError, OSError):
            raise LabError("the virtual lab ended before its devices were ready") from None
        if opened.problem:
            raise LabError(f"the virtual lab did not start: {opened.problem}")
        return devices_at(opened.endpoints, self._config, self._clock)

    def apply_load(self, load: Load, start: float) -> None:
        """Apply a load to the tip; the load's time 0 is `start` of the station's clock [s]. An ended lab ignores it."""
        self._child.send(SetForce(load, start))

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Replace all active and planned faults; their time 0 is `start` of the station's clock [s]."""
        self._child.send(InjectFaults(tuple(faults), start))

    def close(self) -> None:
        """End the lab."""
        self._child.close(2.0)
