"""The frictional plant: a simulated real robot with friction, clearance and weight, whose precurvature drifts.

Play of the drives and parameter errors are the same as in the module `plant`. Each base sensor carries its tube and the
guide that keeps the tube straight behind the front plate.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.errors import NoSolution, NotFinite
from core.model.cosserat import path_rows, to_plate
from core.robot.robot import Array, Robot, tube_poses, unpack
from station.config.loads import GRAVITY
from station.config.robots import STANDARD_GRAVITY
from station.devices.interfaces import GroundTruth
from station.lab.config import PlantConfig
from station.lab.frictional_rod import FrictionContact, integrate, settle, slots
from station.lab.plant import Plant, PlantState, TubeShape, true_robot

#: Time between two random draws; the walk is interpolated linearly between them [s].
KNOT_INTERVAL_S = 10.0


class RandomWalk:
    """Brownian walk of each tube's precurvature; its values do not depend on the times at which they are read."""

    def __init__(self, hourly: float, tubes: int, rng: np.random.Generator) -> None:
        """Create the walks; `hourly` is the standard deviation of the precurvature after an hour, as a fraction."""
        self._deviation = hourly * np.sqrt(KNOT_INTERVAL_S / 3600.0)
        self._rng = rng
        self._knots = [np.zeros(tubes)]

    def at(self, time: float) -> Array:
        """Return the change of each tube's precurvature (q,) at `time` >= 0 [s], as a fraction."""
        knots = max(time, 0.0) / KNOT_INTERVAL_S
        before = int(knots)
        while len(self._knots) < before + 2:
            last = self._knots[-1]
            self._knots.append(last + self._deviation * self._rng.standard_normal(last.size))
        part = knots - before
        return (1.0 - part) * self._knots[before] + part * self._knots[before + 1]


#: Largest residual of the rod's boundary conditions [1/m and N m]; it leaves an error below 1e-8 m at the tip.
RESIDUAL_TOLERANCE = 1e-7


class FrictionalPlant:
    """The simulated real robot with friction, which follows the stages' positions."""

    def __init__(self, robot: Robot, config: PlantConfig, rng: np.random.Generator, positions: Array) -> None:
        self.robot = true = true_robot(robot, config, rng)
        q, n, k = len(true.tubes), len(true.joints), true.layout.ends.shape[1]
        self._walk = RandomWalk(config.walk, q, rng.spawn(1)[0]) if config.walk > 0.0 else None
        self._layout = true.packed.copy()
        self._curvatures, self._drawn = unpack(self._layout).curvatures, true.layout.curvatures
        self._step, self._size = config.step, (q, n, k)
        self._contact = np.inf  # arc length at which the force acts [m]
        self._packed = np.zeros(_size(q, n, k))
        memory = self._memory = _unpack(self._packed, q, n, k)
        memory.play[:] = [config.play.get(joint.name, 0.0) for joint in robot.joints]
        memory.numbers[:] = 2.0 * config.friction / config.couple, config.stick, config.clearance
        for row, tube in zip(memory.tubes, true.tubes, strict=True):
            area = 0.25 * np.pi * (tube.outer_diameter**2 - tube.inner_diameter**2)
            row[:] = 0.5 * tube.outer_diameter, STANDARD_GRAVITY * config.density * area
        memory.gravity[:] = np.array(GRAVITY) @ true.base.rotation
        memory.stages[:] = memory.tubes_at[:] = positions
        if not self._initialise(positions, np.zeros(3), np.inf):
            raise NoSolution(f"the true robot has no equilibrium shape at joints {positions.tolist()} [rad, m]")

    @property
    def tubes_at(self) -> Array:
        """Joint positions (n,) of the tubes; they lag the stages within the play of the drives [rad or m]."""
        return self._memory.tubes_at

    @property
    def rotation(self) -> Array:
        """Frame of the innermost tube at the tip (3, 3), world frame."""
        return self._memory.rotation.copy()

    def shape(self) -> TubeShape:
        """Return the true shape at the last tick."""
        memory, (q, n, k) = self._memory, self._size
        path = path_rows(self.robot, self._step)
        beta = _trace(self._layout, self._packed, q, n, k, self._contact, self._step, path)
        return TubeShape.of(self.robot, beta, path, memory.force, self._contact)

    def memory(self) -> Array:
        """Return a copy of the state between ticks, for `restore`."""
        return self._packed.copy()

    def restore(self, memory: Array) -> None:
        """Restore an earlier state that the method `memory` has returned."""
        self._packed[:] = memory

    def advance(self, positions: Array, force: Array, contact: float = np.inf, now: float = 0.0) -> PlantState:
        """Move the joints to `positions` (n,) with `force` (3,) [N] at arc length `contact` [m], inf for the tip.

        `now` is the time for the random walk [s].

        Raises:
            NotFinite, NoSolution: the force is not finite, or the plant (simulated real robot) has no equilibrium
                shape there; the plant then keeps its last shape.
        """
        if not np.isfinite(force).all():
            raise NotFinite(f"force {force.tolist()} N must be three finite numbers")
        if self._walk is not None:
            self._curvatures[:] = (1.0 + self._walk.at(now))[:, None, None] * self._drawn
        if not self._step_to(positions, force, contact) and not self._subdivide(positions, force, contact):
            raise NoSolution(f"the true robot has no shape at joints {positions.tolist()} under {force.tolist()} N")
        memory, self._contact = self._memory, contact
        truth = GroundTruth(memory.tip.copy(), force, direction=memory.rotation[:, 2].copy())
        return PlantState(truth, memory.wrenches.copy())

    def _step_to(self, positions: Array, force: Array, contact: float) -> bool:
        """Move to the positions in one step with friction; if no solution exists, return false and change nothing."""
        q, n, k = self._size
        return _advance(self._layout, self._packed, q, n, k, positions, force, contact, self._step, RESIDUAL_TOLERANCE)

    def _subdivide(self, positions: Array, force: Array, contact: float) -> bool:
        """Reach the positions in shorter steps; if the robot snaps to a new shape, solve it without friction."""
        before = self._packed.copy()
        stages, last_force = self._memory.stages.copy(), self._memory.force.copy()
        for parts in (4, 16, 64):
            if all(
                self._step_to(stages + part * (positions - stages), last_force + part * (force - last_force), contact)
                for part in np.arange(1, parts + 1) / parts
            ):
                return True
            self._packed[:] = before
        if self._initialise(positions, force, contact):
            return True
        self._packed[:] = before
        return False

    def _initialise(self, positions: Array, force: Array, contact: float) -> bool:
        """Solve the shape without a previous one: without friction, and with a load that increases in steps."""
        memory = self._memory
        for parts in (1, 4, 16, 64):
            memory.unknowns[:], memory.chord[:], memory.friction[:] = 0.0, 0.0, 0.0
            for part in range(1, parts + 1):
                memory.friction[:] = 0.0
                if not self._step_to(positions, part / parts * force, contact):
                    break
                memory.unknowns[1] = memory.unknowns[0]
            else:
                return True
        return False


class _FrictionalPlantMemory(NamedTuple):
    """State of a frictional plant between ticks: views of one packed array, as compiled code needs it."""

    stages: Array  #: (n,) positions of the stages at the last tick [rad or m]
    force: Array  #: (3,) load at the last tick [N]
    tubes_at: Array  #: (n,) joint positions of the tubes; they lag the stages within the play of the drives [rad or m]
    play: Array  #: (n,) play of each joint's drive [rad or m]
    beta: Array  #: (q,) proximal ends of the tubes at the last tick [m]
    friction: Array  #: (slots, 4) state of the friction, see `frictional_rod`
    numbers: Array  #: (3,) parameters of the friction: grip [1/m], stick [m], gap [m]
    tubes: Array  #: (q, 2) radius [m] and weight [N/m] of each tube
    gravity: Array  #: (3,) direction of gravity in the axes of the plate
    unknowns: Array  #: (2, q + 2) unknowns of the rod's boundary-value problem, at this tick and the previous one
    chord: Array  #: (q + 2, q + 2) inverse derivative of the boundary conditions, from which Newton's method starts
    tip: Array  #: (3,) position of the tip, world frame [m]
    rotation: Array  #: (3, 3) frame of the innermost tube at the tip, world frame
    wrenches: Array  #: (q, 6) wrench that each tube exerts on its base sensor, in the sensor's axes [N, N m]


@compiled
def _size(q: int, n: int, k: int) -> int:
    """Return the length of the packed memory of q tubes of at most k sections and n joints."""
    return 3 * n + 12 + q + 4 * max(q - 1, 1) * q * k + 2 * q + 2 * (q + 2) + (q + 2) * (q + 2) + 9 + 6 * q


@compiled
def _unpack(packed: Array, q: int, n: int, k: int) -> _FrictionalPlantMemory:
    """Return views of the packed memory."""
    count = max(q - 1, 1) * q * k
    a = 3 * n
    b = a + 12
    c = b + q
    d = c + 4 * count
    e = d + 2 * q
    f = e + 2 * (q + 2)
    g = f + (q + 2) * (q + 2)
    return _FrictionalPlantMemory(
        packed[:n],
        packed[a : a + 3],
        packed[n : 2 * n],
        packed[2 * n : a],
        packed[b:c],
        packed[c:d].reshape(count, 4),
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
    """Compute one tick; return false and change nothing if the rod has no solution."""
    layout, memory = unpack(robot), _unpack(packed, q, n, k)
    tubes_at = memory.tubes_at.copy()
    for j in range(n):
        half = 0.5 * memory.play[j]
        tubes_at[j] = min(max(tubes_at[j], positions[j] - half), positions[j] + half)
    alpha, beta, _ = tube_poses(layout, tubes_at)
    rough = FrictionContact(
        memory.numbers[0], memory.numbers[1], memory.numbers[2], memory.tubes[:, 0], memory.tubes[:, 1], memory.gravity
    )
    guess, slid, bases = np.empty(q + 2), np.empty(q), np.zeros((q, 6))
    for i in range(q):
        slid[i] = beta[i] - memory.beta[i]
    # The solver starts from the extrapolation of the last two solutions, which is accurate during a steady motion.
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
        _base_wrench(bases[i], memory.wrenches[i], alpha[i], beta[i], memory.tubes[i, 1], memory.gravity)
    return True


@compiled
def _trace(
    robot: Array, packed: Array, q: int, n: int, k: int, contact: float, step: float, path: Array
) -> Array:  # fmt: skip
    """Write the centre line at the last tick to `path` (m, 7), in the plate's axes; return the proximal ends (q,) [m].

    The tubes do not move here, so the friction is constant and the integration gives the shape of the last tick.
    """
    layout, memory = unpack(robot), _unpack(packed, q, n, k)
    alpha, beta, _ = tube_poses(layout, memory.tubes_at)
    rough = FrictionContact(
        memory.numbers[0], memory.numbers[1], memory.numbers[2], memory.tubes[:, 0], memory.tubes[:, 1], memory.gravity
    )
    wrench = np.zeros(6)
    copy(memory.force, wrench)
    force = to_plate(layout, wrench)
    friction, bases = np.zeros((slots(layout), 4)), np.zeros((q, 6))
    y, ends = np.empty(9 + 2 * q), np.empty(q + 2)
    integrate(
        layout, rough, alpha, beta, force, contact, memory.unknowns[0], step, np.zeros(q), memory.friction, friction,
        y, ends, bases, path,
    )  # fmt: skip
    return beta


@compiled
def _base_wrench(base: Array, wrench: Array, alpha: float, beta: float, weight: float, gravity: Array) -> None:
    """Convert a tube's wrench at the plate, plus the tube's weight behind the plate, to its sensor's axes (6,)."""
    world = base.copy()
    hidden = -beta * weight
    for k in range(3):
        world[k] += hidden * gravity[k]
    # Add the moment of the weight behind the plate: (0, 0, beta / 2) x weight.
    world[3] -= 0.5 * beta * hidden * gravity[1]
    world[4] += 0.5 * beta * hidden * gravity[0]
    cos, sin = np.cos(alpha), np.sin(alpha)
    fx, fy = world[0], world[1]
    # The sensor measures the moment about the tube's proximal end (0, 0, beta): m - (0, 0, beta) x f.
    mx, my = world[3] + beta * fy, world[4] - beta * fx
    wrench[0], wrench[1], wrench[2] = cos * fx + sin * fy, cos * fy - sin * fx, world[2]
    wrench[3], wrench[4], wrench[5] = cos * mx + sin * my, cos * my - sin * mx, world[5]


def true_plant(
    robot: Robot, config: PlantConfig, rng: np.random.Generator, positions: Array
) -> Plant | FrictionalPlant:
    """Return the configured plant with its stages at `positions` (n,).

    Raises:
        PoseError, NoSolution: the robot has no equilibrium shape at `positions`.
    """
    return (FrictionalPlant if config.rod == "rough" else Plant)(robot, config, rng, positions)
