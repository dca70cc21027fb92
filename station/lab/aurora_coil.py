"""The coil of a simulated Aurora tracker. It measures frames at a fixed rate, independent of the host's requests."""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from core.robot.robot import Array
from station.devices.aurora.session import USUAL_REPLY_S
from station.devices.aurora.tracker import TrackerMounting
from station.lab.config import LabConfig, TrackerConfig

WAVE_COUNT = 8
#: Shortest and longest wave of the distortion [m]; the shortest is longer than half of the measured cube.
MIN_WAVELENGTH_M, MAX_WAVELENGTH_M = 0.30, 1.0
#: Number of points along each edge of the measured cube at which the RMS of the distortion is computed.
GRID_POINTS = 12


@dataclass(frozen=True)
class Distortion:
    """Position error of the tracker by nearby metal: a smooth function of the position, constant in time.

    The error is a sum of plane waves, drawn from a seed and scaled to the configured RMS.
    """

    waves: Array  #: wave vectors (w, 3) [rad/m]
    phases: Array  #: (w,) [rad]
    amplitudes: Array  #: (w, 3) [m]

    @classmethod
    def drawn(cls, rms: float, box: Array, rng: np.random.Generator) -> Self:
        """Return errors whose length has this RMS [m] over a box, the lower and upper bound of each axis (3, 2) [m]."""
        directions = rng.standard_normal((WAVE_COUNT, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        waves = directions * (2.0 * np.pi / rng.uniform(MIN_WAVELENGTH_M, MAX_WAVELENGTH_M, (WAVE_COUNT, 1)))
        field = cls(waves, rng.uniform(0.0, 2.0 * np.pi, WAVE_COUNT), rng.standard_normal((WAVE_COUNT, 3)))
        edges = [np.linspace(low, high, GRID_POINTS) for low, high in box]
        errors = field.at(np.stack(np.meshgrid(*edges), axis=-1).reshape(-1, 3))
        found = float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
        return cls(field.waves, field.phases, field.amplitudes * (rms / found))

    def at(self, positions: Array) -> Array:
        """Return the errors (..., 3) [m] at `positions` (..., 3) [m]."""
        return np.sin(positions @ self.waves.T + self.phases) @ self.amplitudes


#: Pose of the field generator in the virtual lab: 0.2 m behind the front plate, turned by half a turn about x, so that
#: the robot's workspace is in the middle of the measurement volume.
GENERATOR_POSE = TrackerMounting(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -0.2]))


def assumed_mounting(config: LabConfig) -> TrackerMounting:
    """Return the assumed pose in the robot's frame of the tracker, or with cameras of their world frame."""
    return TrackerMounting(np.eye(3), np.zeros(3)) if config.cameras else GENERATOR_POSE


#: Measurement volume, a 0.5 m cube in the generator's frame, and distance beyond it at which a coil is lost [mm].
VOLUME_MM = ((-250.0, 250.0), (-250.0, 250.0), (-550.0, -50.0))
VISIBLE_BEYOND_MM = 50.0
#: Number of frames for which random noise is drawn at once, because single draws are slow.
NOISE_BLOCK = 64


class CoilView(NamedTuple):
    """One frame of a coil as the tracker measured it."""

    frame: int
    available: float  #: time from which the commands BX and TX report this frame [s]
    position: tuple[float, ...]  #: position of the coil in the generator's frame [mm]
    quaternion: tuple[float, ...]
    beyond: float  #: distance of the coil from the measurement volume [mm]; not positive inside
    lost: bool


class Coil:
    """A five-degree-of-freedom coil in the generator's field."""

    def __init__(
        self, config: TrackerConfig, rng: np.random.Generator, mount: TrackerMounting, field: Distortion | None = None
    ) -> None:
        """Create the coil.

        `field` is the distortion that another coil of the same tracker uses; None draws a new one as configured.
        """
        self.due = 0.0  #: time of the next frame [s]
        self._config, self._rng, self._mount = config, rng, mount
        # The distortion has a separate random stream, so that the noise is the same with and without distortion.
        self.distortion = (
            Distortion.drawn(config.distortion, 1e-3 * np.array(VOLUME_MM), rng.spawn(1)[0])
            if config.distortion > 0.0 and field is None
            else field
        )
        # The noise of the direction has a separate random stream, so that the noise of the position does not change.
        self._wobble = None if config.direction_noise is None else rng.spawn(1)[0]
        self._noise: list[list[float]] = []  # position noise of the coming frames; the last entry is used first [m]
        self._axis_noise: list[Array] = []  # noise of the axis in the coming frames; the last entry is used first
        # The configured latency includes the duration of the reply, so a frame is available earlier by this duration.
        self._delay = max(0.0, config.latency - USUAL_REPLY_S)
        self._frames: deque[CoilView] = deque(maxlen=400)
        self._count, self._count_base = 0, 0

    def advance(
        self, start: float, end: float, tip_start: Array, tip_end: Array, direction: Array | None, lost: bool
    ) -> None:
        """Move the coil from `tip_start` to `tip_end` [m], axis `direction`; if `lost`, the tracker does not see it."""
        while self.due <= end + 1e-9:
            part = 1.0 if end == start else min(max((self.due - start) / (end - start), 0.0), 1.0)
            if not self._noise:
                self._noise = (self._config.noise * self._rng.standard_normal((NOISE_BLOCK, 3)))[::-1].tolist()
            ends = zip(tip_start.tolist(), tip_end.tolist(), self._noise.pop(), strict=True)
            tip = np.array([first + part * (last - first) + noise for first, last, noise in ends])
            local = self._mount.rotation.T @ (tip - self._mount.position)
            if self.distortion is not None:
                local += self.distortion.at(local)
            position = (1e3 * local).tolist()
            beyond = max(max(low - x, x - high) for x, (low, high) in zip(position, VOLUME_MM, strict=True))
            axis = None if direction is None else self._mount.rotation.T @ self._noisy(direction)
            frame = (self._count - self._count_base) & 0xFFFFFFFF
            hidden = lost or beyond > VISIBLE_BEYOND_MM
            self._frames.append(
                CoilView(frame, self.due + self._delay, tuple(position), _without_roll(axis), beyond, hidden)
            )
            self._count += 1
            self.due = self._count / self._config.rate

    def _noisy(self, direction: Array) -> Array:
        """Return the measured axis of the coil, with noise in the two lateral directions; its length is not 1."""
        noise = self._config.direction_noise
        if self._wobble is None or not noise:
            return direction
        if not self._axis_noise:
            self._axis_noise = list(noise * self._wobble.standard_normal((NOISE_BLOCK, 3)))[::-1]
        error = self._axis_noise.pop()
        return direction + error - (error @ direction) * direction

    def restart_count(self) -> None:
        """Restart the numbers of the frames at 0 with the next frame."""
        self._count_base = self._count

    def newest(self, time: float) -> CoilView | None:
        """Return the newest frame that the commands BX and TX report at `time` [s]; None if there is none."""
        while len(self._frames) > 1 and self._frames[1].available <= time:
            self._frames.popleft()
        return self._frames[0] if self._frames and self._frames[0].available <= time else None


def _without_roll(axis: Array | None) -> tuple[float, ...]:
    """Return the quaternion of the shortest rotation of z onto `axis`; a five-degree-of-freedom coil has no roll."""
    if axis is None:
        return (1.0, 0.0, 0.0, 0.0)
    x, y, z = (axis / math.sqrt(axis @ axis)).tolist()
    if z < -1.0 + 1e-12:
        return (0.0, 1.0, 0.0, 0.0)
    w = math.sqrt(0.5 * (1.0 + z))
    return (w, -0.5 * y / w, 0.5 * x / w, 0.0)
