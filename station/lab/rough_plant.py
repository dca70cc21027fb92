"""The true robot of a bench as it is: friction, clearance and weight in the rod, precurvature that walks.

The same play and wrong parameters as `plant`; here each base sensor carries its own tube. The guide that holds a
tube straight behind the plate is borne by that tube's sensor.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.errors import NoSolution, NotFinite
from core.model.rough_rod import Contact, settle, slots
from core.robot.robot import Array, Robot, tube_poses, unpack
from station.config.robots import STANDARD
from station.devices.interfaces import Truth
from station.lab.config import PlantConfig
from station.lab.loads import GRAVITY
from station.lab.plant import PlantState, true_robot
from station.lab.walk import Walk

#: Of the end conditions [1/m and N m]: less than 1e-8 m at the tip.
TOLERANCE = 1e-7


class RoughPlant:
    """The true robot at the stages' positions."""

    def __init__(self, robot: Robot, config: PlantConfig, rng: np.random.Generator, positions: Array) -> None:
        self.robot = true = true_robot(robot, config, rng)
        q, n, k = len(true.tubes), len(true.joints), true.layout.ends.shape[1]
        self._walk = Walk(config.walk, q, rng.spawn(1)[0]) if config.walk > 0.0 else None
        self._layout = true.packed.copy()
        self._curvatures, self._drawn = unpack(self._layout).curvatures, true.layout.curvatures
        self._step, self._size = config.step, (q, n, k)
        self._packed = np.zeros(_size(q, n, k))
        memory = self._memory = _unpack(self._packed, q, n, k)
        memory.play[:] = [config.play.get(joint.name, 0.0) for joint in robot.joints]
        memory.numbers[:] = 2.0 * config.friction / config.couple, config.stick, config.clearance
        for row, tube in zip(memory.tubes, true.tubes, strict=True):
            area = 0.25 * np.pi * (tube.outer_diameter**2 - tube.inner_diameter**2)
            row[:] = 0.5 * tube.outer_diameter, STANDARD * config.density * area
        memory.gravity[:] = np.array(GRAVITY) @ true.base.rotation
        memory.stages[:] = memory.tubes_at[:] = positions
        if not self._begin(positions, np.zeros(3), np.inf):
            raise NoSolution(f"the true robot has no shape at {positions.tolist()} [rad, m]")

    @property
    def rotation(self) -> Array:
        """Frame of the innermost tube at the tip (3, 3), world frame."""
        return self._memory.rotation.copy()

    def advance(self, positions: Array, force: Array, contact: float = np.inf, now: float = 0.0) -> PlantState:
        """Move the joints to `positions` (n,) with `force` (3,) [N] at arc length `contact` [m], inf for the tip.

        `now` is the time that has passed for what walks [s].

        Raises:
            NotFinite, NoSolution: the true robot cannot stand so; it stays as it was.
        """
        if not np.isfinite(force).all():
            raise NotFinite(f"force {force.tolist()} N must be three finite numbers")
        if self._walk is not None:
            self._curvatures[:] = (1.0 + self._walk.at(now))[:, None, None] * self._drawn
        if not self._go(positions, force, contact) and not self._in_parts(positions, force, contact):
            raise NoSolution(f"the true robot has no shape at {positions.tolist()} [rad, m] under {force.tolist()} N")
        memory = self._memory
        truth = Truth(memory.tip.copy(), force, direction=memory.rotation[:, 2].copy())
        return PlantState(truth, memory.wrenches.copy())

    def _go(self, positions: Array, force: Array, contact: float) -> bool:
        """One step along the way, friction with it; nothing has changed where it fails."""
        q, n, k = self._size
        return _advance(self._layout, self._packed, q, n, k, positions, force, contact, self._step, TOLERANCE)

    def _in_parts(self, positions: Array, force: Array, contact: float) -> bool:
        """A long way in short ones; a snap has no way, it shakes friction off and the tubes stand anew."""
        before = self._packed.copy()
        stages, felt = self._memory.stages.copy(), self._memory.force.copy()
        for parts in (4, 16, 64):
            if all(
                self._go(stages + part * (positions - stages), felt + part * (force - felt), contact)
                for part in np.arange(1, parts + 1) / parts
            ):
                return True
            self._packed[:] = before
        if self._begin(positions, force, contact):
            return True
        self._packed[:] = before
        return False

    def _begin(self, positions: Array, force: Array, contact: float) -> bool:
        """Stand there without a past: no friction yet, the load brought on in parts."""
        memory = self._memory
        for parts in (1, 4, 16, 64):
            memory.unknowns[:], memory.chord[:], memory.friction[:] = 0.0, 0.0, 0.0
            for part in range(1, parts + 1):
                memory.friction[:] = 0.0
                if not self._go(positions, part / parts * force, contact):
                    break
                memory.unknowns[1] = memory.unknowns[0]
            else:
                return True
        return False


class _Memory(NamedTuple):
    """What a plant keeps from one tick to the next: views of one packed array."""

    stages: Array  #: (n,) where they were [rad or m]
    force: Array  #: (3,) that acted [N]
    tubes_at: Array  #: (n,) where the tubes are behind the play of their drives [rad or m]
    play: Array  #: (n,) [rad or m]
    beta: Array  #: (q,) proximal ends at the last tick [m]
    friction: Array  #: (slots, 4), see `rough_rod`
    numbers: Array  #: (3,) grip [1/m], stick [m], gap [m]
    tubes: Array  #: (q, 2) radius [m] and weight [N/m]
    gravity: Array  #: (3,) axes of the plate
    unknowns: Array  #: (2, q + 2) of the rod, now and at the tick before
    chord: Array  #: (q + 2, q + 2)
    tip: Array  #: (3,) world frame [m]
    rotation: Array  #: (3, 3) frame of the innermost tube at the tip, world frame
    wrenches: Array  #: (q, 6) that each tube exerts on its base sensor, in the sensor's axes [N, N m]


@compiled
def _size(q: int, n: int, k: int) -> int:
    """Length of the packed memory of q tubes of at most k sections and n joints."""
    return 3 * n + 12 + q + 4 * max(q - 1, 1) * q * k + 2 * q + 2 * (q + 2) + (q + 2) * (q + 2) + 9 + 6 * q


@compiled
def _unpack(packed: Array, q: int, n: int, k: int) -> _Memory:
    """Views of the packed memory."""
    places = max(q - 1, 1) * q * k
    a = 3 * n
    b = a + 12
    c = b + q
    d = c + 4 * places
    e = d + 2 * q
    f = e + 2 * (q + 2)
    g = f + (q + 2) * (q + 2)
    return _Memory(
        packed[:n],
        packed[a : a + 3],
        packed[n : 2 * n],
        packed[2 * n : a],
        packed[b:c],
        packed[c:d].reshape(places, 4),
        packed[a + 3 : a + 6],
        packed[d:e].reshape(q, 2),
        packed[a + 6 : a + 9],
        packed[e:f].reshape(2, q + 2),
        packed[f:g].reshape(q + 2, q + 2),
        packed[a + 9 : b],
        packed[g : g + 9].reshape(3, 3),
        packed[g + 9 : g + 9 + 6 * q].reshape(q, 6),
    )


@compiled
def _advance(
    robot: Array, packed: Array, q: int, n: int, k: int, positions: Array, force: Array, contact: float,
    step: float, tolerance: float,
) -> bool:  # fmt: skip
    """One tick in one call; false where the rod has not followed, and then nothing has changed."""
    layout, memory = unpack(robot), _unpack(packed, q, n, k)
    tubes_at = memory.tubes_at.copy()
    for j in range(n):
        half = 0.5 * memory.play[j]
        tubes_at[j] = min(max(tubes_at[j], positions[j] - half), positions[j] + half)
    alpha, beta, _ = tube_poses(layout, tubes_at)
    rough = Contact(
        memory.numbers[0], memory.numbers[1], memory.numbers[2], memory.tubes[:, 0], memory.tubes[:, 1], memory.gravity
    )
    guess, slid, bases = np.empty(q + 2), np.empty(q), np.zeros((q, 6))
    for i in range(q):
        slid[i] = beta[i] - memory.beta[i]
    # Along a steady motion the line through the last two solutions ends next to this one.
    for i in range(q + 2):
        guess[i] = 2.0 * memory.unknowns[0, i] - memory.unknowns[1, i]
    friction = np.zeros((slots(layout), 4))
    unknowns, chord, tip, rotation, residual = settle(
        layout, rough, alpha, beta, force, contact, guess, memory.chord, step, tolerance, slid, memory.friction,
        friction, bases,
    )  # fmt: skip
    if not residual <= tolerance:
        unknowns, chord, tip, rotation, residual = settle(
            layout, rough, alpha, beta, force, contact, memory.unknowns[0], np.zeros((q + 2, q + 2)), step, tolerance,
            slid, memory.friction, friction, bases,
        )  # fmt: skip
        if not residual <= tolerance:
            return False
    copy(memory.unknowns[0], memory.unknowns[1])
    copy(unknowns, memory.unknowns[0])
    for i in range(q + 2):
        copy(chord[i], memory.chord[i])
    for i in range(friction.shape[0]):
        copy(friction[i], memory.friction[i])
    for i in range(3):
        copy(rotation[i], memory.rotation[i])
    copy(tip, memory.tip)
    copy(beta, memory.beta)
    copy(tubes_at, memory.tubes_at)
    copy(positions, memory.stages)
    copy(force, memory.force)
    for i in range(q):
        _feel(bases[i], memory.wrenches[i], alpha[i], beta[i], memory.tubes[i, 1], memory.gravity)
    return True


@compiled
def _feel(base: Array, wrench: Array, alpha: float, beta: float, weight: float, gravity: Array) -> None:
    """What a tube exerts at the plate (6,), and what lies behind it weighs, in the axes of its sensor (6,)."""
    world = base.copy()
    hidden = -beta * weight
    for k in range(3):
        world[k] += hidden * gravity[k]
    # (0, 0, beta / 2) x weight
    world[3] -= 0.5 * beta * hidden * gravity[1]
    world[4] += 0.5 * beta * hidden * gravity[0]
    cos, sin = np.cos(alpha), np.sin(alpha)
    fx, fy = world[0], world[1]
    # moment about (0, 0, beta): m - (0, 0, beta) x f
    mx, my = world[3] + beta * fy, world[4] - beta * fx
    wrench[0], wrench[1], wrench[2] = cos * fx + sin * fy, cos * fy - sin * fx, world[2]
    wrench[3], wrench[4], wrench[5] = cos * mx + sin * my, cos * my - sin * mx, world[5]
