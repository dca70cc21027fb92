"""Two cameras that see a moving point, with the driver of their tracker, in virtual time."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from core.robot.robot import Array
from station.devices.cameras import CameraFile, LensFile
from station.devices.config import Mount
from station.devices.interfaces import TipReading
from station.devices.projection import CameraView, view_of
from station.devices.stereo.sighting import Sighting, pack
from station.devices.stereo.tracker import StereoTracker
from station.lab.wires import MemoryInbox

LENS = LensFile(focal=(1280.0, 1280.0), centre=(640.0, 360.0))
PERIOD_S, LATENCY_S = 1.0 / 30.0, 0.04
#: Station's clock minus the loop's clock [s].
CLOCK_OFFSET_S = 5000.0
CAMERAS = {
    "left": CameraFile(
        width=1280, height=720, lens=LENS, pose=Mount(position=(0, -0.5, 0), rotation_vector=(-math.pi / 2, 0, 0))
    ),
    "right": CameraFile(
        width=1280, height=720, lens=LENS, pose=Mount(position=(-0.5, 0, 0), rotation_vector=(0, math.pi / 2, 0))
    ),
}


def views() -> dict[str, CameraView]:
    return {name: view for name, camera in CAMERAS.items() if (view := view_of(camera)) is not None}


class Rig:
    """Two cameras that see a moving point; their frames are not synchronised."""

    def __init__(self, path: Callable[[float], Array], **options: Any) -> None:
        self.inbox = MemoryInbox()
        self.tracker = StereoTracker(self.inbox, CAMERAS, **options)
        self.tracker.connect(0.0)
        self.path, self.views = path, views()
        self.frames = dict.fromkeys(CAMERAS, 0)
        self.phases = {"left": 0.004, "right": 0.021}
        self.lost: Callable[[str, float], bool] = lambda name, time: False
        self.hidden: Callable[[str, float], bool] = lambda name, time: False
        self.shift = {"left": np.zeros(2), "right": np.zeros(2)}  #: added to the pixels
        self.processing = {"left": 0.0, "right": 0.0}  #: time to find the ball in a frame, in which others are lost [s]
        self.times: list[float] = []  #: times of the polls that returned a reading [s]

    def run(self, until: float, start: float = 0.0) -> list[TipReading]:
        """Poll the driver every 2 ms and return its readings."""
        readings: list[TipReading] = []
        due = {name: start + phase for name, phase in self.phases.items()}
        arrivals: list[tuple[float, bytes]] = []
        for now in np.arange(start, until, 0.002):
            for name, view in self.views.items():
                if now < due[name]:
                    continue
                time, due[name] = due[name], due[name] + max(PERIOD_S, self.processing[name])
                self.frames[name] += 1
                if self.lost(name, time):
                    continue
                pixel = view.project(self.path(time)[None])[0] + self.shift[name]
                if self.hidden(name, time):
                    pixel = np.full(2, math.nan)
                sent = time + LATENCY_S + self.processing[name]
                sighting = Sighting(name, self.frames[name], CLOCK_OFFSET_S + time, CLOCK_OFFSET_S + sent, *pixel)
                arrivals.append((sent, pack(sighting)))
            for arrival, data in [one for one in arrivals if one[0] <= now]:
                self.inbox.put(data)
                arrivals.remove((arrival, data))
            if (reading := self.tracker.poll(float(now))) is not None:
                readings.append(reading)
                self.times.append(float(now))
        return readings
