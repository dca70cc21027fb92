"""Cameras of the virtual lab in virtual time: each renders its frames, finds the ball and sends its pixels.

The live lab needs no such cameras: there the cameras' processes render the frames.
"""

from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from core.errors import ContractError
from core.robot.robot import Robot
from station.devices.cameras import CameraFile, SimulationFile
from station.devices.projection import true_view_of
from station.devices.stereo.ball import find_ball
from station.devices.stereo.sighting import Sighting, pack
from station.lab.plant import TubeShape
from station.lab.rendering import Renderer

#: Time to decode a frame and find the ball [s].
PROCESSING_S = 0.012


class _Exposure(NamedTuple):
    """A frame that the camera has exposed and not yet processed."""

    arrival: float  #: [s]
    number: int
    shape: TubeShape


class SimulatedCamera:
    """One simulated camera. `seed` determines noise, lost frames and the phase of the frames."""

    def __init__(self, name: str, camera: CameraFile, robot: Robot, seed: int) -> None:
        view = true_view_of(camera)
        if view is None:
            raise ContractError(f"camera '{name}' has no lens or no pose, so the virtual lab cannot simulate it")
        self._name, self._camera = name, camera
        self._simulation = camera.simulation or SimulationFile()
        self._renderer = Renderer(robot, camera, view, seed)
        self._random = np.random.default_rng((seed, 1))
        self._period = 1.0 / camera.rate
        self._due = self._random.uniform(0.0, self._period)
        self._number = 0
        self._coming: deque[_Exposure] = deque()

    def advance(self, now: float, shape: Callable[[], TubeShape]) -> bytes | None:
        """Expose and process the frames until `now` [s]; return the datagram of a processed frame."""
        if now >= self._due - 1e-9:
            self._due += self._period
            self._number += 1
            if self._random.random() >= self._simulation.dropped:
                self._coming.append(_Exposure(now + self._simulation.latency, self._number, shape()))
        if not self._coming or now < self._coming[0].arrival + PROCESSING_S - 1e-9:
            return None
        arrival, number, shown = self._coming.popleft()
        ball = find_ball(self._renderer.render(shown), self._camera.ball)
        at = (float("nan"),) * 2 if ball is None else (ball.column, ball.row)
        return pack(Sighting(self._name, number, arrival - self._camera.latency, now, *at))


def simulated_cameras(cameras: Mapping[str, CameraFile], robot: Robot, seed: int) -> tuple[SimulatedCamera, ...]:
    """Return the cameras of a virtual lab."""
    return tuple(
        SimulatedCamera(name, camera, robot, seed + 1000 * number)
        for number, (name, camera) in enumerate(cameras.items(), 1)
    )
