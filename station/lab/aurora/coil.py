"""What a simulated Aurora measures: frames of its coil, at its own rate whether it is asked or not."""

from collections import deque
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array
from station.devices.aurora.tracker import Registration
from station.lab.aurora.distortion import Distortion
from station.lab.config import TrackerConfig

#: How the generator stands in the virtual lab: below the plate, its z axis down, so that the robot's
#: workspace is in the middle of its volume.
MOUNT = Registration(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, -0.2]))
#: The 0.5 m cube that is measured, in the generator's frame, and how far beyond it a coil is still seen [mm].
VOLUME = ((-250.0, 250.0), (-250.0, 250.0), (-550.0, -50.0))
SEEN_BEYOND = 50.0
#: Noise is drawn for so many frames at once.
BLOCK = 64
#: One tool's BX reply at 115200 baud, part of the configured latency [s].
USUAL_REPLY = 10.0 * 53 / 115200


class Seen(NamedTuple):
    """One frame as measured."""

    frame: int
    available: float  #: when BX and TX begin to tell it [s]
    position: tuple[float, ...]  #: in the generator's frame [mm]
    quaternion: tuple[float, ...]
    beyond: float  #: how far outside the volume [mm]
    lost: bool


class Coil:
    """A five-degree-of-freedom coil in the generator's field."""

    def __init__(
        self, config: TrackerConfig, rng: np.random.Generator, mount: Registration, field: Distortion | None = None
    ) -> None:
        """`field` is another coil's in the same place; without it is drawn, as far as `config` has one."""
        self.due = 0.0  #: when the next frame is measured [s]
        self._config, self._rng, self._mount = config, rng, mount
        # From a stream of its own, so that the noise is the same with and without.
        self.distortion = (
            Distortion.drawn(config.distortion, 1e-3 * np.array(VOLUME), rng.spawn(1)[0])
            if config.distortion > 0.0 and field is None
            else field
        )
        # Likewise the noise of the direction.
        self._wobble = None if config.direction_noise is None else rng.spawn(1)[0]
        self._noise: list[list[float]] = []  # of the frames to come, the next one last [m]
        self._frames: deque[Seen] = deque(maxlen=400)
        self._count, self._count_base = 0, 0

    def advance(
        self, begin: float, end: float, tip_begin: Array, tip_end: Array, direction: Array | None, lost: bool
    ) -> None:
        """The coil goes from `tip_begin` to `tip_end`, world frame [m], along `direction`; `lost`: it is not seen."""
        while self.due <= end + 1e-9:
            part = 1.0 if end == begin else min(max((self.due - begin) / (end - begin), 0.0), 1.0)
            if not self._noise:
                self._noise = (self._config.noise * self._rng.standard_normal((BLOCK, 3)))[::-1].tolist()
            tip = tip_begin + part * (tip_end - tip_begin) + self._noise.pop()
            place = self._mount.rotation.T @ (tip - self._mount.position)
            if self.distortion is not None:
                place += self.distortion.at(place)
            position = (1e3 * place).tolist()
            beyond = max(max(low - x, x - high) for x, (low, high) in zip(position, VOLUME, strict=True))
            axis = None if direction is None else self._mount.rotation.T @ self._wobbling(direction)
            # The configured latency ends with the arrival of the reply.
            available = self.due + max(0.0, self._config.latency - USUAL_REPLY)
            frame = (self._count - self._count_base) & 0xFFFFFFFF
            self._frames.append(
                Seen(frame, available, tuple(position), _without_roll(axis), beyond, lost or beyond > SEEN_BEYOND)
            )
            self._count += 1
            self.due = self._count / self._config.rate

    def _wobbling(self, direction: Array) -> Array:
        """The axis as it is measured: a little off in the two directions across, not of unit length."""
        noise = self._config.direction_noise
        if self._wobble is None or not noise:
            return direction
        off = noise * self._wobble.standard_normal(3)
        return direction + off - (off @ direction) * direction

    def count_anew(self) -> None:
        """The next frame is number 0."""
        self._count_base = self._count

    def newest(self, time: float) -> Seen | None:
        """What BX and TX tell at `time` [s]."""
        while len(self._frames) > 1 and self._frames[1].available <= time:
            self._frames.popleft()
        return self._frames[0] if self._frames and self._frames[0].available <= time else None


def _without_roll(axis: Array | None) -> tuple[float, ...]:
    """Quaternion that turns z onto `axis` the short way: a five-degree-of-freedom coil knows no more."""
    if axis is None:
        return (1.0, 0.0, 0.0, 0.0)
    x, y, z = axis / np.linalg.norm(axis)
    if z < -1.0 + 1e-12:
        return (0.0, 1.0, 0.0, 0.0)
    w = float(np.sqrt(0.5 * (1.0 + z)))
    return (w, float(-0.5 * y / w), float(0.5 * x / w), 0.0)
