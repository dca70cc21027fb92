"""Real hardware, with the interface of the virtual lab's process; it exists independently of the station."""

from collections.abc import Sequence

from station.config.loads import Load
from station.devices.config import BenchFile
from station.lab.faults import LabFault


class HardwareRig:
    """Devices of the station's file; there is no process, no simulated load and no simulated fault."""

    alive = True

    def __init__(self, devices: BenchFile) -> None:
        self._devices = devices

    def devices(self) -> BenchFile:
        """Return the devices that the control process has to open."""
        return self._devices

    def apply_load(self, load: Load, start: float) -> None:
        """Do nothing: the operator applies real loads."""

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Do nothing: faults cannot be injected into real devices."""

    def close(self) -> None:
        """Do nothing: real hardware has no process to end."""
