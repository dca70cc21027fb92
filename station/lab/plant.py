"""The true robot: exact rods with their own parameters, play in the drive, friction between tubes.

It answers to stage positions and a tip force with the tip and with what each base sensor would
feel. Quasi-static: the tubes are light and stiff against 500 Hz.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from core.compiled import compiled
from core.cosserat import ExactRod, Rod
from core.robot import Array, Robot
from station.devices.interfaces import Truth
from station.lab.config import PlantConfig


class PlantState(NamedTuple):
    """Where the true robot stands."""

    truth: Truth
    wrenches: Array  #: (q, 6) that each tube exerts on its base sensor, in the sensor's axes [N, N m]


def true_robot(robot: Robot, config: PlantConfig, rng: np.random.Generator) -> Robot:
    """The robot as it really is: errors by name, or drawn within +-`vary` from `rng`."""
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
        elif config.poisson_ratio is not None:
            true = replace(true, poisson_ratio=config.poisson_ratio)
        tubes.append(true)
    return replace(robot, tubes=tuple(tubes))


class Plant:
    """The true robot at the stages' positions."""

    def __init__(self, robot: Robot, config: PlantConfig, rng: np.random.Generator, positions: Array) -> None:
        self.robot = true_robot(robot, config, rng)
        # 1e-7 of the end conditions leaves less than 1e-8 m at the tip.
        self._rod_solver = ExactRod(self.robot, step=config.step, tolerance=1e-7)
        self._play = np.array([config.play.get(joint.name, 0.0) for joint in robot.joints])
        self._tubes_at = positions.copy()
        self._friction = np.zeros((len(robot.tubes), 2))
        self._most_friction = np.array([config.friction_force, config.friction_moment])
        self._torsion = np.array([tube.bending_stiffness / tube.stiffness_ratio for tube in self.robot.tubes])
        self._poses = self.robot.tube_poses(positions)
        self._to_plate = np.ascontiguousarray(self.robot.base.rotation.T)
        self._plate = np.array(self.robot.base.position)
        self._rod: Rod = self._rod_solver.solve(positions, np.zeros(6))
        self._before = self._rod

    def advance(self, positions: Array, force: Array) -> PlantState:
        """Move the stages to `positions` (n,) with `force` (3,) [N] at the tip.

        Raises:
            PoseError, NoSolution: the true robot cannot stand so.
        """
        half = 0.5 * self._play
        self._tubes_at = np.minimum(np.maximum(self._tubes_at, positions - half), positions + half)
        poses = self.robot.tube_poses(self._tubes_at)
        wrench = np.zeros(6)
        wrench[:3] = force
        # Extrapolating the last two solutions saves a Newton step in most ticks.
        guess = self._rod._replace(unknowns=2.0 * self._rod.unknowns - self._before.unknowns)
        self._before, self._rod = self._rod, self._rod_solver.solve_tubes(*poses, wrench, guess)
        # The sensors stand on the plate: load and tip as seen from there.
        pull, tip = self._to_plate @ force, self._to_plate @ (self._rod.tip - self._plate)
        torsion = self._torsion * self._rod.torsion
        wrenches = _base_wrenches(pull, tip, torsion, self._friction, self._most_friction, self._poses, poses)
        self._poses = poses
        return PlantState(Truth(self._rod.tip, force), wrenches)


#: How far tubes move against each other before friction has turned round [m, rad].
STICK = (20e-6, 1.7e-3)


@compiled
def _base_wrenches(
    force: Array, tip: Array, torsion: Array, friction: Array, most: Array,
    before: tuple[Array, Array], poses: tuple[Array, Array],
) -> Array:  # fmt: skip
    """Shares of the load at the bases (q, 6), each in its sensor's axes; `friction` (q, 2) goes on with the motion.

    The guide belongs to the outermost tube's holder and takes all bending; an inner tube's base
    feels its own torsion and friction, the innermost also the axial pull of the load. The shares
    add up to the tip load, so the way they are split cancels in the fusion. Friction is Coulomb's
    with a stick zone: what the outer of two neighbours does to the inner one, and back.
    """
    alpha, beta = poses
    q = alpha.shape[0]
    world = np.zeros((q, 6))  # at the plate's origin, world axes
    for i in range(q - 1):
        for k in range(2):
            slip = (poses[1 - k][i + 1] - before[1 - k][i + 1]) - (poses[1 - k][i] - before[1 - k][i])
            now = friction[i, k] + slip * most[k] / STICK[k]
            friction[i, k] = min(max(now, -most[k]), most[k])
            world[i, 2 + 3 * k] += friction[i, k]
            world[i + 1, 2 + 3 * k] -= friction[i, k]
        world[i, 5] += torsion[i]
    if q > 1:
        world[0, 2] += force[2]
    total = np.array([
        force[0], force[1], force[2],
        tip[1] * force[2] - tip[2] * force[1],
        tip[2] * force[0] - tip[0] * force[2],
        tip[0] * force[1] - tip[1] * force[0],
    ])  # fmt: skip
    for k in range(6):
        share = 0.0
        for i in range(q - 1):
            share += world[i, k]
        world[q - 1, k] = total[k] - share
    for i in range(q):
        cos, sin = np.cos(alpha[i]), np.sin(alpha[i])
        fx, fy = world[i, 0], world[i, 1]
        # moment about (0, 0, beta): m - (0, 0, beta) x f
        mx, my = world[i, 3] + beta[i] * fy, world[i, 4] - beta[i] * fx
        world[i, 0], world[i, 1] = cos * fx + sin * fy, cos * fy - sin * fx
        world[i, 3], world[i, 4] = cos * mx + sin * my, cos * my - sin * mx
    return world
