"""Motion planner of a G-code board: straight blocks, constant acceleration, look-ahead to the end of the queue."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

JUNCTION_DEVIATION = 0.01  #: GRBL's default, which is about Marlin's [unit]


@dataclass
class Block:
    """One straight motion of all axes."""

    direction: tuple[float, ...]  #: unit vector
    length: float  #: [unit]
    speed: float  #: [unit/s]
    acceleration: float  #: [unit/s^2]
    entry: float  #: largest speed at the block's start [unit/s]


class Planner:
    """Axes that execute queued blocks."""

    def __init__(self, axes: int, capacity: int) -> None:
        self.capacity, self.time = capacity, 0.0
        self.position = [0.0] * axes  #: [unit]
        self.blocks: deque[Block] = deque()
        self.rates = [1e3] * axes  #: largest speeds [unit/s]
        self.accelerations = [1e3] * axes  #: [unit/s^2]
        self._end = [0.0] * axes
        self._speed = 0.0
        self._clamped: set[int] = set()
        self.holding = False  #: whether the axes brake; at rest they empty the queue

    @property
    def moving(self) -> bool:
        """Whether a motion is in progress."""
        return bool(self.blocks)

    @property
    def full(self) -> bool:
        """Whether no further block fits."""
        return len(self.blocks) >= self.capacity

    @property
    def end(self) -> tuple[float, ...]:
        """Position at the end of the queue [unit]."""
        return tuple(self._end)

    def put(self, target: Sequence[float], duration: float) -> None:
        """Queue a motion to `target` [unit] that takes at least `duration` [s]."""
        change = [b - a for a, b in zip(self._end, target, strict=True)]
        length = math.sqrt(sum(d * d for d in change))
        if length < 1e-9:
            return
        unit = tuple(d / length for d in change)
        used = [(abs(u), r, a) for u, r, a in zip(unit, self.rates, self.accelerations, strict=True) if abs(u) > 1e-9]
        speed = min([length / max(duration, 1e-6), *(rate / u for u, rate, _ in used)])
        acceleration = min(a / u for u, _, a in used)
        entry = 0.0
        if self.blocks:
            last = self.blocks[-1]
            cosine = -sum(a * b for a, b in zip(last.direction, unit, strict=True))
            sine = math.sqrt(max(0.0, 0.5 * (1.0 - cosine)))
            limit = math.inf if sine > 0.999999 else math.sqrt(acceleration * JUNCTION_DEVIATION * sine / (1.0 - sine))
            entry = min(limit, last.speed, speed)
        self.blocks.append(Block(unit, length, speed, acceleration, entry))
        self._end = list(target)

    def hold(self) -> None:
        """Start to brake; empty the queue when the axes are at rest."""
        self.holding = bool(self.blocks)

    def halt(self) -> None:
        """Stop without a ramp and empty the queue."""
        self.blocks.clear()
        self._speed, self.holding, self._end = 0.0, False, list(self.position)

    def clamp(self, axes: set[int]) -> None:
        """Keep these axes and their counts at rest while blocks are executed."""
        if self._clamped - axes:
            self.halt()  # a released axis counts from its present position
        self._clamped = axes

    def set_position(self, axis: int, position: float) -> None:
        """Set the coordinate of an axis at rest."""
        self.halt()
        self.position[axis] = self._end[axis] = position

    def advance(self, until: float) -> None:
        """Execute blocks until the time `until` [s]."""
        left = until - self.time
        self.time = until
        while left > 1e-12 and self.blocks:
            block = self.blocks[0]
            exit_speed = 0.0
            for later in reversed(list(self.blocks)[1:]):
                exit_speed = min(later.entry, math.sqrt(exit_speed**2 + 2.0 * later.acceleration * later.length))
            left = self._run(block, 0.0 if self.holding else exit_speed, left)
            if self.holding and self._speed < 1e-9:
                self.halt()

    def _run(self, block: Block, exit_speed: float, left: float) -> float:
        """Execute the first block for at most `left` [s], and return the remaining time [s]."""
        v, a, r = self._speed, block.acceleration, block.length
        if self.holding:
            phases = [(-a, v / a)]
        else:
            peak = math.sqrt(max(0.0, min(block.speed**2, 0.5 * (v * v + exit_speed**2 + 2.0 * a * r))))
            peak = max(peak, v) if v <= block.speed + 1e-9 else v
            brake = max(0.0, (peak**2 - exit_speed**2) / (2.0 * a))
            cruise = r - (peak**2 - v * v) / (2.0 * a) - brake
            phases = [
                (a, (peak - v) / a),
                (0.0, max(0.0, cruise) / peak if peak > 1e-12 else 0.0),
                (-a, max(0.0, peak - exit_speed) / a),
            ]
        for acceleration, duration in phases:
            step = min(duration, left)
            if step <= 0.0:
                continue
            distance = (self._speed + 0.5 * acceleration * step) * step
            if distance >= block.length:  # the block ends within this phase
                full = self._time_to(block.length, acceleration)
                self._speed = max(0.0, self._speed + acceleration * full)
                self._finish(block)
                return left - full
            self._move(block, distance)
            self._speed = max(0.0, self._speed + acceleration * step)
            left -= step
            if left <= 1e-12:
                return 0.0
        if not self.holding:
            self._speed = exit_speed
            self._finish(block)
        return left

    def _time_to(self, distance: float, acceleration: float) -> float:
        if abs(acceleration) < 1e-12:
            return distance / self._speed
        root = math.sqrt(max(0.0, self._speed**2 + 2.0 * acceleration * distance))
        return 2.0 * distance / max(self._speed + root, 1e-12)

    def _move(self, block: Block, distance: float) -> None:
        block.length -= distance
        for i, u in enumerate(block.direction):
            if i not in self._clamped:
                self.position[i] += u * distance

    def _finish(self, block: Block) -> None:
        self._move(block, block.length)
        self.blocks.popleft()
        if not self.blocks:
            self._speed = 0.0
            self.position = [p if i in self._clamped else self._end[i] for i, p in enumerate(self.position)]
