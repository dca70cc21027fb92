"""A simulated Aurora tracker and its driver on a serial line in memory, in virtual time."""

from typing import Any

import numpy as np

from station.devices.aurora.dialogue import AuroraSettings
from station.devices.aurora.tracker import AuroraTracker, TrackerReport
from station.devices.interfaces import TipReading
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import TrackerConfig
from station.lab.simulated_aurora import SimulatedAurora, pump
from station.lab.wires import HostPort

TICK = 0.002
REST = np.array([0.010, -0.020, 0.190])


class AuroraBench:
    """Test bench that advances the simulated Aurora and its driver tick by tick."""

    def __init__(
        self, settings: AuroraSettings | None = None, seed: int = 0, noise: float = 0.0, rate: float = 40.0, **unit: Any
    ) -> None:
        """`rate` is the number of frames that the unit measures per second."""
        self.unit = SimulatedAurora(TrackerConfig(noise=noise, rate=rate), np.random.default_rng(seed), **unit)
        self.port = HostPort("aurora")
        self.tracker = AuroraTracker(self.port, settings, GENERATOR_POSE)
        self.now = 0.0

    def run(self, seconds: float, tip=lambda time: REST, target=lambda time: REST) -> list[tuple[float, TipReading]]:
        """Advance by `seconds`, with the true tip at `tip(time)` and a second coil at `target(time)`.

        Returns:
            Time and value of each reading of the driver.
        """
        read = []
        for _ in range(round(seconds / TICK)):
            before, self.now = self.now, self.now + TICK
            ways = (tip(before), tip(self.now)), (target(before), target(self.now))
            self.unit.advance(before, self.now, *ways[0], target=ways[1])
            pump(self.port.device, self.unit, self.now)
            reading = self.tracker.poll(self.now)
            if reading is not None:
                read.append((self.now, reading))
        return read

    @property
    def report(self) -> TrackerReport:
        return self.tracker.report(self.now)
