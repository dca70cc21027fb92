"""The smooth plant: a simulated real robot of exact rods, with play of the drives and friction at the tubes' bases.

The module `frictional_plant` is the realistic alternative. From the stages' positions and a force at the tip, the plant
computes the position of the tip and the wrench on each base sensor. The simulation is quasi-static, because the tubes
are so light and stiff that they follow changes at 500 Hz without delay.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.control.sensors import fuse
from core.model.cosserat import NO_LOADS, ExactRod, Rod, path_rows, shoot, trace, world_path
from core.model.solution import pure_force
from core.robot.robot import Array, Robot, tube_poses, unpack
from station.devices.interfaces import GroundTruth
from station.lab.config import PlantConfig


class PlantState(NamedTuple):
    """State of the simulated real robot."""

    truth: GroundTruth
    wrenches: Array  #: (q, 6) wrench that each tube exerts on its base sensor, in the sensor's axes [N, N m]


def on_sensors(robot: Robot, tubes_at: Array, wrenches: Array) -> Array:
    """Return the wrenches (s, 6) on the force sensors for `wrenches` (q, 6) of the tubes at joints `tubes_at` (n,)."""
    if robot.sensed == "robot":
        return np.concatenate(fuse(wrenches, *robot.tube_poses(tubes_at)))[None]
    return wrenches[robot.layout.carried]


class TubeShape(NamedTuple):
    """True shape of the tubes, as a camera sees it; only simulated cameras may receive it."""

    #: (k, 7) centre line from the plate to the last tube end: arc length [m], position [m], unit tangent; world frame
    line: Array
    ends: Array  #: (q,) arc length of each tube's distal end from the plate [m], innermost tube first
    force: Array  #: (3,) force on the tubes, world frame [N]
    contact: float  #: arc length at which the force acts [m]; inf: the tip

    @classmethod
    def of(cls, robot: Robot, beta: Array, path: Array, force: Array, contact: float) -> "TubeShape":
        """Return the shape of a robot whose proximal ends are at `beta` (q,) [m]; `path` is in the plate's axes."""
        ends = beta + np.array([tube.length for tube in robot.tubes])
        return cls(world_path(robot, path), ends, force.copy(), contact)


def true_robot(robot: Robot, config: PlantConfig, rng: np.random.Generator) -> Robot:
    """Return the robot with the configured errors of its tubes, given by tube name or drawn within +-`vary`."""
    tubes = []
    for tube in robot.tubes:
        error = config.tubes.get(tube.name)
        stiffness, curvature = (error.stiffness, error.curvature) if error else (0.0, 0.0)
        if config.vary > 0.0:
            stiffness, curvature = rng.uniform(-config.vary, config.vary, 2)
        sections = tuple(
            replace(section, curvature=tuple((1.0 + curvature) * u for u in section.curvature))
            for section in tube.sections
        )
        true = replace(tube, sections=sections, bending_stiffness=(1.0 + stiffness) * tube.bending_stiffness)
        if tube.torsional_stiffness is not None:
            true = replace(true, torsional_stiffness=(1.0 + stiffness) * tube.torsional_stiffness)
        elif config.poisson_ratio != "described":
            true = replace(true, poisson_ratio=config.poisson_ratio)
        tubes.append(true)
    return replace(robot, tubes=tuple(tubes))


class Plant:
    """The simulated real robot, which follows the stages' positions."""

    def __init__(self, robot: Robot, config: PlantConfig, rng: np.random.Generator, positions: Array) -> None:
        self.robot = true_robot(robot, config, rng)
        # A tolerance of 1e-7 of the boundary conditions leaves an error below 1e-8 m at the tip.
        self._exact = ExactRod(self.robot, step=config.step, tolerance=1e-7)
        q, n = len(robot.tubes), len(robot.joints)
        self._packed = np.zeros(_size(q, n))
        self._tip = self._packed.size - 12 - 6 * q  # index of the tip in the packed memory
        self._memory = memory = _unpack(self._packed, q, n)
        memory.play[:] = [config.play.get(joint.name, 0.0) for joint in robot.joints]
        memory.limit[:] = config.friction_force, config.friction_moment
        memory.stiffness[:] = [tube.bending_stiffness / tube.stiffness_ratio for tube in self.robot.tubes]
        memory.tubes_at[:] = positions
        memory.poses[:] = self.robot.tube_poses(positions)
        self._load: tuple[Array, float] = np.zeros(3), np.inf  # force [N] and its arc length [m]
        self._store(self._exact.solve(positions, np.zeros(6)))

    def shape(self) -> TubeShape:
        """Return the true shape at the last tick."""
        alpha, beta = self.robot.tube_poses(self._memory.tubes_at)
        path = path_rows(self.robot, self._exact.step)
        force, contact = self._load
        unknowns = self._memory.unknowns[0]
        trace(self.robot.layout, alpha, beta, pure_force(force), contact, NO_LOADS, unknowns, self._exact.step, path)
        return TubeShape.of(self.robot, beta, path, force, contact)

    @property
    def tubes_at(self) -> Array:
        """Joint positions (n,) of the tubes; they lag the stages within the play of the drives [rad or m]."""
        return self._memory.tubes_at

    @property
    def rotation(self) -> Array:
        """Frame of the innermost tube at the tip (3, 3), world frame."""
        return self._memory.rotation.copy()

    def memory(self) -> Array:
        """Return a copy of the state between ticks, for `restore`."""
        return self._packed.copy()

    def restore(self, memory: Array) -> None:
        """Restore an earlier state that the method `memory` has returned."""
        self._packed[:] = memory

    def advance(
        self,
        positions: Array,
        force: Array,
        contact: float = np.inf,
        now: float = 0.0,  # noqa: ARG002 - no parameter changes over time
    ) -> PlantState:
        """Move the joints to `positions` (n,) with `force` (3,) [N] at arc length `contact` [m], inf for the tip.

        Raises:
            NotFinite, NoSolution: the plant (simulated real robot) has no equilibrium shape there; its shape is kept.
        """
        exact, packed, last = self._exact, self._packed, self._load
        self._load = force, contact
        if not _advance(self.robot.packed, packed, positions, force, contact, exact.step, exact.tolerance):
            poses = self.robot.tube_poses(self._memory.tubes_at)
            rod = self._follow(np.stack(poses), force, contact, last)
            self._store(rod or exact.solve_tubes(*poses, pure_force(force), None, contact))
            _base_wrenches(self.robot.packed, packed, force, contact)
        state = packed[self._tip :].copy()  # tip, wrenches and rotation
        truth = GroundTruth(state[:3], force, None, state[-7::3].copy())
        return PlantState(truth, state[3:-9].reshape(-1, 6))

    def _follow(self, poses: Array, force: Array, contact: float, last: tuple[Array, float]) -> Rod | None:
        """Return the shape at tube poses (2, q), followed from the last shape in shorter steps; None if it snaps."""
        memory, exact = self._memory, self._exact
        before = last[0] if last[1] == contact else np.zeros(3)
        for parts in (4, 16, 64):
            unknowns = memory.unknowns[0]
            rod: Rod | None = Rod(memory.tip, memory.rotation, unknowns[2:], unknowns, memory.chord, 0)
            for part in np.arange(1, parts + 1) / parts:
                alpha, beta = memory.poses + part * (poses - memory.poses)
                wrench = pure_force(before + part * (force - before))
                rod = rod and exact.near(rod, alpha, beta, wrench, contact)
            if rod is not None:
                return rod
        return None

    def _store(self, rod: Rod) -> None:
        """Store a solution as the start of the next tick."""
        memory = self._memory
        memory.unknowns[:] = rod.unknowns
        memory.chord[:], memory.tip[:], memory.rotation[:] = rod.chord, rod.tip, rod.rotation


class _PlantMemory(NamedTuple):
    """State of a plant between ticks: views of one packed array, as compiled code needs it."""

    tubes_at: Array  #: (n,) joint positions of the tubes; they lag the stages within the play of the drives [rad or m]
    play: Array  #: (n,) play of each joint's drive [rad or m]
    poses: Array  #: (2, q) rotations [rad] and proximal ends [m] of the tubes at the last tick
    friction: Array  #: (q, 2) axial force [N] and moment [N m] between a tube and the next outer one
    limit: Array  #: (2,) largest friction force [N] and moment [N m]
    stiffness: Array  #: (q,) torsional stiffness GJ of each tube [N m^2]
    unknowns: Array  #: (2, q + 2) unknowns of the rod's boundary-value problem, at this tick and the previous one
    chord: Array  #: (q + 2, q + 2) inverse derivative of the boundary conditions, from which Newton's method starts
    tip: Array  #: (3,) position of the tip, world frame [m]
    wrenches: Array  #: (q, 6) wrench on each base sensor [N, N m]
    rotation: Array  #: (3, 3) frame of the innermost tube at the tip, world frame


@compiled
def _size(q: int, n: int) -> int:
    """Return the length of the packed memory of q tubes and n joints."""
    return 2 * n + 2 * q + 2 * q + 2 + q + 2 * (q + 2) + (q + 2) * (q + 2) + 3 + 6 * q + 9


@compiled
def _unpack(packed: Array, q: int, n: int) -> _PlantMemory:
    """Return views of the packed memory."""
    a = 2 * n
    b = a + 2 * q
    c = b + 2 * q
    d = c + 2 + q
    e = d + 2 * (q + 2)
    f = e + (q + 2) * (q + 2)
    return _PlantMemory(
        packed[:n],
        packed[n:a],
        packed[a:b].reshape(2, q),
        packed[b:c].reshape(q, 2),
        packed[c : c + 2],
        packed[c + 2 : d],
        packed[d:e].reshape(2, q + 2),
        packed[e:f].reshape(q + 2, q + 2),
        packed[f : f + 3],
        packed[f + 3 : f + 3 + 6 * q].reshape(q, 6),
        packed[f + 3 + 6 * q : f + 12 + 6 * q].reshape(3, 3),
    )


@compiled
def _advance(
    robot: Array, packed: Array, positions: Array, force: Array, contact: float, step: float, tolerance: float
) -> bool:
    """Compute one tick. If the rod has no solution, return false; only `tubes_at` has changed then."""
    layout = unpack(robot)
    q, n = layout.counts.shape[0], positions.shape[0]
    memory = _unpack(packed, q, n)
    for j in range(n):
        half = 0.5 * memory.play[j]
        memory.tubes_at[j] = min(max(memory.tubes_at[j], positions[j] - half), positions[j] + half)
    alpha, beta, _ = tube_poses(layout, memory.tubes_at)
    wrench, guess = np.zeros(6), np.empty(q + 2)
    copy(force, wrench)
    # The solver starts from the extrapolation of the last two solutions, which is accurate during a steady motion.
    for i in range(q + 2):
        guess[i] = 2.0 * memory.unknowns[0, i] - memory.unknowns[1, i]
    unknowns, chord, tip, rotation, _, residual = shoot(
        layout, alpha, beta, wrench, contact, np.empty((0, 4)), guess, memory.chord, step, tolerance
    )
    if not residual <= tolerance:
        return False
    copy(memory.unknowns[0], memory.unknowns[1])
    copy(unknowns, memory.unknowns[0])
    copy(tip, memory.tip)
    for i in range(q + 2):
        copy(chord[i], memory.chord[i])
    for i in range(3):
        copy(rotation[i], memory.rotation[i])
    _base_wrenches(robot, packed, force, contact)
    return True


#: Relative displacement of tubes over which friction reverses [m, rad].
STICK_PATH = (20e-6, 1.7e-3)


@compiled
def _base_wrenches(robot: Array, packed: Array, load: Array, contact: float) -> None:
    """Compute the wrench on each base sensor (q, 6), in the sensor's axes, and update the friction.

    The guide belongs to the outermost tube's holder and takes all bending. An inner tube's sensor measures the torsion
    and friction of that tube; the innermost tube's sensor also measures the axial force of the load. All wrenches add
    up to the tip load, so their split does not affect the sum. Coulomb friction with a stick zone acts between
    neighbouring tubes, with opposite signs on the two tubes.
    """
    layout = unpack(robot)
    q, n = layout.counts.shape[0], layout.joint_tube.shape[0]
    memory = _unpack(packed, q, n)
    friction, limit, poses, world = memory.friction, memory.limit, memory.poses, memory.wrenches
    now = np.empty((2, q))
    alphas, betas, _ = tube_poses(layout, memory.tubes_at)
    copy(alphas, now[0])
    copy(betas, now[1])
    # The sensors are on the plate: transform load and tip to its frame.
    force, tip = np.zeros(3), np.zeros(3)
    for i in range(3):
        for k in range(3):
            force[i] += layout.base[3 * k + i] * load[k]
            tip[i] += layout.base[3 * k + i] * (memory.tip[k] - layout.base[9 + k])
    world[:] = 0.0  # wrenches about the plate's origin, in the plate's axes
    for i in range(q - 1):
        for k in range(2):
            slip = (now[1 - k, i + 1] - poses[1 - k, i + 1]) - (now[1 - k, i] - poses[1 - k, i])
            trial = friction[i, k] + slip * limit[k] / STICK_PATH[k]
            friction[i, k] = min(max(trial, -limit[k]), limit[k])
            world[i, 2 + 3 * k] += friction[i, k]
            world[i + 1, 2 + 3 * k] -= friction[i, k]
        world[i, 5] += memory.stiffness[i] * memory.unknowns[0, 2 + i]
    if q > 1:
        world[0, 2] += force[2]
    moment = (
        tip[1] * force[2] - tip[2] * force[1],
        tip[2] * force[0] - tip[0] * force[2],
        tip[0] * force[1] - tip[1] * force[0],
    )
    if contact < np.inf:
        # Moment of the rod at the plate: r x F for the point on the shaft at which the force acts.
        twist = 0.0
        for i in range(q):
            twist += memory.stiffness[i] * memory.unknowns[0, 2 + i]
        moment = (memory.unknowns[0, 0], memory.unknowns[0, 1], twist)
    total = (force[0], force[1], force[2], moment[0], moment[1], moment[2])
    for k in range(6):
        share = 0.0
        for i in range(q - 1):
            share += world[i, k]
        world[q - 1, k] = total[k] - share
    for i in range(q):
        alpha, beta = now[0, i], now[1, i]
        cos, sin = np.cos(alpha), np.sin(alpha)
        fx, fy = world[i, 0], world[i, 1]
        # The sensor measures the moment about the tube's proximal end (0, 0, beta): m - (0, 0, beta) x f.
        mx, my = world[i, 3] + beta * fy, world[i, 4] - beta * fx
        world[i, 0], world[i, 1] = cos * fx + sin * fy, cos * fy - sin * fx
        world[i, 3], world[i, 4] = cos * mx + sin * my, cos * my - sin * mx
    for k in range(2):
        copy(now[k], poses[k])
