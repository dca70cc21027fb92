"""A bench of one's own in the place of the virtual lab's process: it stands there, whoever controls it."""

from collections.abc import Sequence

from station.devices.config import BenchFile
from station.lab.faults import LabFault
from station.lab.loads import Load


class OwnBench:
    """What the station's file says about the devices; nothing to start, to pull at or to spoil."""

    alive = True

    def __init__(self, devices: BenchFile) -> None:
        self._devices = devices

    def devices(self) -> BenchFile:
        """What the control process has to open."""
        return self._devices

    def apply_load(self, load: Load, start: float) -> None:
        """A real tip is pulled at by hand; a run's load is only what a person has announced."""

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Real devices have faults of their own."""

    def close(self) -> None:
        """Nothing to do: a real bench stays where it is."""
