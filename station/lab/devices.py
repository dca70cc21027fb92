"""Simulated stages, tracker and base sensors, linked to the plant directly.

They have the hold, delay, quantisation, noise and drift of real ones, but no bytes.
"""

from collections import deque

import numpy as np

from core.robot import Array
from station.devices.interfaces import JointReading, TipReading, WrenchReading
from station.lab.config import BaseSensorConfig, LineConfig, TrackerConfig
from station.robots import JointFile

#: Speeds of a T-series stage come in multiples of this many microsteps per second.
SPEED_UNIT = 9.375


class SimulatedStages:
    """Axes on one serial line: each takes the latest command in its turn, some time later."""

    def __init__(self, joints: tuple[JointFile, ...], line: LineConfig, positions: Array) -> None:
        self.positions = positions.copy()  #: true positions of the stages (n,)
        self._line = line
        self._lower = np.array([joint.lower for joint in joints])
        self._upper = np.array([joint.upper for joint in joints])
        self._speed = np.array([joint.speed for joint in joints])
        self._acceleration = np.array([joint.acceleration for joint in joints])
        self._microstep = np.array([joint.microstep for joint in joints])
        self._sent = np.zeros(len(joints))
        self._target = np.zeros(len(joints))
        self._velocity = np.zeros(len(joints))
        self._asked = np.zeros(len(joints))
        self._waiting: set[int] = set()  # axes that have not got the latest command yet
        self._due = self._turns(0.0)  # of each axis, to use the line
        self._on_the_way: deque[tuple[float, int, float]] = deque()

    def poll(self, now: float) -> JointReading:  # noqa: ARG002 - the lab has moved to `now` already
        """Positions as the stages count them."""
        positions = self.positions
        if self._line.quantised:
            positions = np.round(positions / self._microstep) * self._microstep
        return JointReading(positions.copy(), self._sent.copy())

    def command(self, velocities: Array, now: float) -> None:
        """Take note of velocities (n,); each axis gets the latest when its turn comes."""
        self._asked = np.clip(velocities, -self._speed, self._speed)
        idle = now > max(self._due) + self._line.hold  # then the turns begin anew
        self._due = self._turns(now) if idle else [max(due, now) for due in self._due]
        self._waiting = set(range(len(self._due)))
        self._serve(now + 1e-9)

    def stop(self, now: float) -> None:
        """Stop every axis: next on the line, whatever waits."""
        self._waiting.clear()
        self._on_the_way.clear()
        for axis in range(len(self._due)):
            self._send(axis, 0.0, now)

    def advance(self, begin: float, end: float) -> None:
        """Run the motors from `begin` to `end` [s]."""
        self._serve(end - 1e-9)
        time = begin
        while self._on_the_way and self._on_the_way[0][0] <= end:
            due, axis, velocity = self._on_the_way.popleft()
            if due > time:
                self._run(due - time)
                time = due
            self._target[axis] = velocity
        self._run(end - time)

    def _turns(self, now: float) -> list[float]:
        """When each axis has the line: one after the other."""
        count = len(self._lower)
        return [now + self._line.hold * axis / count for axis in range(count)]

    def _serve(self, until: float) -> None:
        """Send to the axes whose turn comes before `until` [s]."""
        for axis in sorted(self._waiting, key=self._due.__getitem__):
            if self._due[axis] < until:
                self._send(axis, self._asked[axis], self._due[axis])
                self._due[axis] += self._line.hold
                self._waiting.remove(axis)

    def _send(self, axis: int, velocity: float, now: float) -> None:
        if self._line.quantised:
            unit = SPEED_UNIT * self._microstep[axis]
            velocity = round(velocity / unit) * unit
        self._sent[axis] = velocity
        self._on_the_way.append((now + self._line.transport, axis, velocity))

    def _run(self, time: float) -> None:
        if self._line.ramps:
            change = np.minimum(
                np.maximum(self._target - self._velocity, -self._acceleration * time), self._acceleration * time
            )
            # The ramp ends when the target speed is reached, perhaps before `time` is over.
            ramp = np.abs(change) / self._acceleration
            self.positions += self._velocity * time + change * (time - 0.5 * ramp)
            self._velocity += change
        else:
            self._velocity = self._target.copy()
            self.positions += self._velocity * time
        inside = np.minimum(np.maximum(self.positions, self._lower), self._upper)
        self._velocity[inside != self.positions] = 0.0  # the end of the travel stops the motor
        self.positions = inside


class SimulatedTracker:
    """Frames at a fixed rate, each arriving a latency later."""

    def __init__(self, config: TrackerConfig, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._frame = 0
        self._on_the_way: deque[TipReading] = deque()

    def advance(self, begin: float, end: float, tip_begin: Array, tip_end: Array) -> None:
        """See the true tip go from `tip_begin` to `tip_end`."""
        while (time := self._frame / self._config.rate) <= end + 1e-9:
            part = 1.0 if end == begin else min(max((time - begin) / (end - begin), 0.0), 1.0)
            tip = tip_begin + part * (tip_end - tip_begin) + self._config.noise * self._rng.standard_normal(3)
            self._on_the_way.append(TipReading(self._frame, time, tip))
            self._frame += 1

    def poll(self, now: float) -> TipReading | None:
        """The newest frame that has arrived."""
        newest = None
        while self._on_the_way and self._on_the_way[0].time + self._config.latency <= now + 1e-9:
            newest = self._on_the_way.popleft()
        return newest


class SimulatedBaseSensors:
    """Noise, quantisation, an offset until tared and a slow drift on the true base wrenches."""

    def __init__(self, config: BaseSensorConfig, tubes: int, rng: np.random.Generator) -> None:
        self._config = config
        self._rng = rng
        self._offset = np.repeat([config.force_offset, config.moment_offset], 3) * rng.uniform(-1.0, 1.0, (tubes, 6))
        self._drift = np.zeros((tubes, 6))
        self._drift[:, :3] = config.drift * rng.choice([-1.0, 1.0], (tubes, 3))
        self._noise = np.repeat([config.force_noise, config.moment_noise], 3)
        count = np.repeat([config.force_count, config.moment_count], 3)
        self._quantised = count > 0.0
        self._count = np.where(self._quantised, count, 1.0)
        self._true = np.zeros((tubes, 6))

    def advance(self, wrenches: Array) -> None:
        """Feel the true wrenches (q, 6) [N, N m]."""
        self._true = wrenches

    def poll(self, now: float) -> WrenchReading:
        """One sample."""
        reading = self._true + self._offset + now * self._drift
        reading = reading + self._noise * self._rng.standard_normal(reading.shape)
        reading = np.where(self._quantised, np.round(reading / self._count) * self._count, reading)
        return WrenchReading(now, reading)
