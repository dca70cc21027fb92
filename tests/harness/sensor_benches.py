"""Every driver of force sensors with two simulated sensors, in virtual time: the same few methods for all of them."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from core.robot.robot import Array
from station.devices.ati.calibration import read_page
from station.devices.ati.netft import NetftSensors
from station.devices.ati.nidaq import CardSensors, Wiring
from station.devices.interfaces import BaseSensors, WrenchReading
from station.lab.simulated_netft import BoxSettings, SimulatedNetft
from station.lab.wires import MemoryDatagramEnd
from tests.harness.netft_bench import PERFECT, WRENCH
from tests.harness.recorded_card import CALIBRATION, RATE, TICK, Recorded, voltages_of

#: Wrenches of the two sensors [N, N m].
WRENCHES = np.array([WRENCH, -0.5 * WRENCH])


class SensorBench(Protocol):
    """Two force sensors and their driver."""

    sensors: BaseSensors
    now: float
    names: tuple[str, str]  #: parts of the sensors' names in every fault's details

    def run(self, seconds: float, wrenches: Array = WRENCHES) -> list[tuple[float, WrenchReading]]:
        """Poll the driver while the sensors feel `wrenches` (2, 6); return all readings with their times."""
        ...

    def silence(self, sensor: int, silent: bool) -> None:
        """Make a sensor send nothing."""
        ...

    def saturate(self, sensor: int, saturated: bool) -> None:
        """Overload a sensor."""
        ...

    def cut(self, sensor: int) -> None:
        """Cut the line of a sensor."""
        ...

    def mend(self, sensor: int) -> None:
        """Repair the line of a sensor."""
        ...


class NetftBench:
    """Two ATI Net F/T boxes."""

    names = ("box 1", "box 2")

    def __init__(self, ends: Sequence[MemoryDatagramEnd] = ()) -> None:
        ends = ends or [MemoryDatagramEnd() for _ in self.names]
        self._boxes = [
            SimulatedNetft(end, PERFECT, np.random.default_rng(i), BoxSettings()) for i, end in enumerate(ends)
        ]
        pages = [read_page(box.page() or b"") for box in self._boxes]
        links = [end.link(name) for end, name in zip(ends, self.names, strict=True)]
        self.sensors = NetftSensors(links, pages)
        self.now = 0.0

    def run(self, seconds: float, wrenches: Array = WRENCHES) -> list[tuple[float, WrenchReading]]:
        readings: list[tuple[float, WrenchReading]] = []
        for _ in range(round(seconds / TICK)):
            self.now = round(self.now + TICK, 9)
            for box, wrench in zip(self._boxes, wrenches, strict=True):
                box.advance(self.now, wrench)
            readings.append((self.now, self.sensors.poll(self.now)))
        return readings

    def silence(self, sensor: int, silent: bool) -> None:
        self._boxes[sensor].faults.mute = silent

    def saturate(self, sensor: int, saturated: bool) -> None:
        self._boxes[sensor].faults.saturate = saturated

    def cut(self, sensor: int) -> None:
        self._boxes[sensor].faults.mute = True  # a box without network is silent, because its datagrams get lost

    def mend(self, sensor: int) -> None:
        self._boxes[sensor].faults.mute = False


class CardBench:
    """Two sensors, each on an analog card."""

    names = ("Dev1", "Dev2")
    LONGEST_S = 20.0

    def __init__(self) -> None:
        self._volts = [self._samples(wrench) for wrench in WRENCHES]
        self.now, self._silent, self._cut = 0.0, [False, False], [False, False]
        self._cards: list[Recorded] = []
        self.sensors = CardSensors(self._opened, [Wiring(0, 0, CALIBRATION), Wiring(1, 0, CALIBRATION)])

    def _samples(self, wrench: Array) -> Array:
        return np.repeat(voltages_of(wrench)[:, None], round(self.LONGEST_S * RATE), axis=1)

    def _opened(self) -> list[Recorded]:
        self._cards = [
            Recorded(name, volts, start=self.now) for name, volts in zip(self.names, self._volts, strict=True)
        ]
        self._break()
        return self._cards

    def _break(self) -> None:
        for card, cut in zip(self._cards, self._cut, strict=True):
            card.broken = f"{card.name}: no such device" if cut else ""

    def run(self, seconds: float, wrenches: Array = WRENCHES) -> list[tuple[float, WrenchReading]]:
        readings: list[tuple[float, WrenchReading]] = []
        for volts, wrench in zip(self._volts, wrenches, strict=True):
            if np.isfinite(volts[0, -1]) and volts[0, -1] < CALIBRATION.volts:
                volts[:] = voltages_of(wrench)[:, None]
        for _ in range(round(seconds / TICK)):
            self.now = round(self.now + TICK, 9)
            for card, silent in zip(self._cards, self._silent, strict=True):
                if not silent:
                    card.now = self.now
            readings.append((self.now, self.sensors.poll(self.now)))
        return readings

    def silence(self, sensor: int, silent: bool) -> None:
        self._silent[sensor] = silent

    def saturate(self, sensor: int, saturated: bool) -> None:
        volts = np.full(6, CALIBRATION.volts) if saturated else voltages_of(WRENCHES[sensor])
        self._volts[sensor][:] = volts[:, None]

    def cut(self, sensor: int) -> None:
        self._cut[sensor] = True
        self._break()

    def mend(self, sensor: int) -> None:
        self._cut[sensor] = False


BENCHES: dict[str, Callable[[], SensorBench]] = {"netft": NetftBench, "nidaq": CardBench}
