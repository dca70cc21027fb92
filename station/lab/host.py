"""The station process's side of the live virtual lab: starts it, asks it."""

from collections.abc import Sequence

from core.errors import CtrError
from station.control.child import Child
from station.devices.config import BenchFile
from station.lab.endpoints import devices_at
from station.lab.faults import LabFault
from station.lab.loads import Load
from station.lab.process import Inject, LabBench, Opened, Pull, run_lab


class LabError(CtrError):
    """A lab that does not come up."""


class LabHost:
    """Owner of the lab's process."""

    def __init__(self, bench: LabBench, ring_name: str, width: int) -> None:
        self._config, self._clock = bench.config, bench.clock
        # It has to outlive this process by a few seconds.
        self._child = Child(run_lab, bench, ring_name, width, name="lab", daemon=False)

    @property
    def alive(self) -> bool:
        """Whether its process runs."""
        return self._child.alive

    @property
    def pid(self) -> int:
        """Number of the lab's process."""
        return self._child.pid

    def devices(self) -> BenchFile:
        """What the control process has to open, once it is there; waits.

        Raises:
            LabError: it did not come up.
        """
        try:
            opened: Opened = self._child.pipe.recv()
        except (EOFError, OSError):
            raise LabError("the virtual lab ended before its devices were there") from None
        if opened.problem:
            raise LabError(f"the virtual lab did not come up: {opened.problem}")
        return devices_at(opened.endpoints, self._config, self._clock)

    def apply_load(self, load: Load, start: float) -> None:
        """Put a load on the tip; its time is 0 at `start` by the station's clock [s]. A lab that is gone has no tip."""
        self._child.tell(Pull(load, start))

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Let these faults happen, instead of those that are on or to come; their time is 0 at `start` [s]."""
        self._child.tell(Inject(tuple(faults), start))

    def close(self) -> None:
        """End it."""
        self._child.close(2.0)
