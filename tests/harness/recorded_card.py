"""A simulated analog card that returns a recording of voltages, and the calibration of its sensors."""

import numpy as np

from station.devices.ati.calibration import GaugeCalibration
from station.devices.links.link import LinkError

RATE = 5000.0
TICK = 0.002
#: Calibration matrix in which every gauge measures every axis, as in real sensors.
MATRIX = np.random.default_rng(1).normal(size=(6, 6)) * np.array([[2.0]] * 3 + [[0.02]] * 3)
CALIBRATION = GaugeCalibration("FT1", "SI-18-0.25", MATRIX, np.array([18.0] * 3 + [0.25] * 3), 10.0)


def voltages_of(wrench: np.ndarray) -> np.ndarray:
    return np.linalg.solve(MATRIX, wrench)


class Recorded:
    """Simulated card that has sampled a recording up to `now`; a read returns the samples since the last read."""

    def __init__(self, name: str, recording: np.ndarray, rate: float = RATE, start: float = 0.0) -> None:
        self.name, self.rate, self.now = name, rate, 0.0
        self._recording, self._start, self._returned = recording, start, 0
        self.broken, self.closed = "", False

    def read(self) -> np.ndarray:
        if self.broken:
            raise LinkError(self.broken)
        # Sample k (from 1) is taken at start + k / rate.
        there = min(max(int((self.now - self._start) * self.rate + 1e-9), self._returned), self._recording.shape[1])
        block, self._returned = self._recording[:, self._returned : there], there
        return block

    def close(self) -> None:
        self.closed = True
