"""Batch of k simulated robots that actions move within their limits; each has hidden tube errors and a hidden load."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from gymnasium.spaces import Box

from core.compiled import compiled
from core.errors import CtrError
from core.model.batch import Solutions
from core.model.cosserat import ExactRod, Rod
from core.model.solution import PASSES, Solution, size
from core.model.statics import Statics
from core.robot.robot import Array, Indices, Robot, Section, Tube
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.solve_many import solve_many


class ShapeSolver(Protocol):
    """Interface of a solver for the tips of k robots; each row of an array belongs to one robot.

    A robot can have several shapes at the same joint positions. A solver starts from the robot's previous shape, so
    that the simulated robot snaps where a real robot would.
    """

    def replace(self, row: int, robot: Robot) -> None:
        """Use another robot in this row from now on."""
        ...

    def solve_from_rest(self, row: int, joints: Array, wrench: Array) -> Array:
        """Return the tips (m, 3) [m] of a row's robot at joints (m, n), NaN where the robot has no shape.

        The solver does not use the robot's previous shape. Afterwards the robot has the shape at `joints[0]`.
        """
        ...

    def follow(self, joints: Array, wrenches: Array) -> tuple[Array, list[int]]:
        """Move all robots to joints (k, n) and wrenches (k, 6); return tips (k, 3) [m] and the rows without a shape.

        Robots without a shape stay at their pose, and their returned tips are invalid.
        """
        ...


class LoadedShapes:
    """Solver that uses the loaded model."""

    def __init__(self, robot: Robot, rows: int) -> None:
        self.models = [Statics(robot)] * rows
        self._alike = True
        self._at = Solutions(
            np.full((rows, size(len(robot.tubes), len(robot.joints))), np.nan), {},
            len(robot.tubes), len(robot.joints),
        )  # fmt: skip

    def replace(self, row: int, robot: Robot) -> None:
        """See `ShapeSolver`."""
        if robot is not self.models[row].robot:
            nominal = self.models[row]  # rows are solved together, so their sub-links are equally long
            self.models[row] = Statics(robot, nominal.step, nominal.used_integrator)
            self._alike = len(self.models) == 1

    def solve_from_rest(self, row: int, joints: Array, wrench: Array) -> Array:
        """See `ShapeSolver`."""
        found = solve_many(self.models[row], joints, np.tile(wrench, (len(joints), 1)), threads=1)
        self._at.numbers[row] = found.numbers[0]
        return found.tip

    def follow(self, joints: Array, wrenches: Array) -> tuple[Array, list[int]]:
        """See `ShapeSolver`."""
        at = self._at
        if len(self.models) == 1:  # for a single robot `solve` is faster than a batch and gives the same result
            near = Solution(at.numbers[0]) if at.numbers[0, PASSES] > 0.0 else None
            try:
                alone = self.models[0].solve(joints[0], wrenches[0], near)
            except CtrError:
                return at.tip.copy(), [0]
            self._at = Solutions(alone.numbers[None], {}, at.tubes, at.joints)
            return alone.tip[None], []
        found = solve_many(self.models[0] if self._alike else self.models, joints, wrenches, near=at)
        lost = list(found.failures)
        tips = found.tip.copy()
        if lost:
            found.numbers[lost] = at.numbers[lost]
        self._at = Solutions(found.numbers, {}, at.tubes, at.joints)
        return tips, lost


class ExactShapes:
    """Solver that uses the exact rod, which is formulated differently from the model and has no sub-links."""

    def __init__(self, robot: Robot, rows: int) -> None:
        self._models = [ExactRod(robot)] * rows
        self._at: list[Rod | None] = [None] * rows

    def replace(self, row: int, robot: Robot) -> None:
        """See `ShapeSolver`."""
        if robot is not self._models[row].robot:
            self._models[row] = ExactRod(robot)

    def solve_from_rest(self, row: int, joints: Array, wrench: Array) -> Array:
        """See `ShapeSolver`."""
        rods = [self._solve(row, pose, wrench, None) for pose in joints]
        self._at[row] = rods[0]
        return np.array([np.full(3, np.nan) if rod is None else rod.tip for rod in rods])

    def follow(self, joints: Array, wrenches: Array) -> tuple[Array, list[int]]:
        """See `ShapeSolver`."""
        tips, lost = np.empty((len(joints), 3)), list[int]()
        for row, (pose, wrench) in enumerate(zip(joints, wrenches, strict=True)):
            rod = self._solve(row, pose, wrench, self._at[row])
            if rod is None:
                lost.append(row)
            else:
                self._at[row], tips[row] = rod, rod.tip
        return tips, lost

    def _solve(self, row: int, joints: Array, wrench: Array, near: Rod | None) -> Rod | None:
        try:
            return self._models[row].solve(joints, wrench, near)
        except CtrError:
            return None


#: Smallest distance between the ends of neighbouring tubes [m].
MIN_TUBE_DISTANCE_M = 1e-9
#: Largest number of random poses that are drawn to find a valid one. If none is valid, the robot file is refused.
MAX_DRAWS = 10_000

Bools = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


@dataclass(frozen=True)
class EpisodeSettings:
    """Settings of an episode: robot, ranges of the hidden parameters, simulation model and duration of an action."""

    robot: str = "paper"  #: name of a preset robot, or path of a .toml file
    load: float = 0.2  #: largest force at the tip, in any direction [N]
    tube_error: float = 0.0  #: largest relative error of each tube's stiffness and curvatures
    exact: bool = False  #: whether the exact rod simulates the robot instead of the loaded model
    period: float = 0.1  #: duration of an action [s]

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("load", self.load, 0.0, 100.0),
            ("tube_error", self.tube_error, 0.0, 0.5),
            ("period", self.period, 1e-4, 10.0),
        ):
            if not low <= value <= high:
                raise ConfigError(f"{name} = {value:g} is outside {low:g} ... {high:g}")


class RobotBatch:
    """Batch of k simulated robots; an action gives each joint's velocity as a fraction of top speed, -1 ... 1."""

    def __init__(self, setting: EpisodeSettings, rows: int) -> None:
        file = load_robot(setting.robot)
        self.setting, self.rows, self.robot = setting, rows, file.robot()
        limits = file.limits()
        self.lower, self.upper, speed = limits.packed[:3]
        self.stride: Array = setting.period * speed
        self._order = limits.order
        self.slides = np.array([joint.motion == "translation" for joint in self.robot.joints])
        self._slides = self.slides.astype(np.int64)
        self._bounds: Array = np.array([self.lower, self.upper, self.stride])
        base = np.abs(self.robot.base.position)
        #: Largest distance of the tip from the world's origin in each direction [m].
        self.reach: Array = base + self.robot.tubes[0].length
        self.shapes: ShapeSolver = (ExactShapes if setting.exact else LoadedShapes)(self.robot, rows)
        self.robots = [self.robot] * rows
        self._width = self.observation_bounds.size
        self.joints, self.wrenches = np.zeros((rows, self.lower.size)), np.zeros((rows, 6))
        self.tips = np.zeros((rows, 3))

    def disturb_robot(self, random: np.random.Generator) -> Robot:
        """Return the robot with random errors of its tubes' stiffnesses and curvatures."""
        error = self.setting.tube_error
        if error == 0.0:
            return self.robot
        return replace(self.robot, tubes=tuple(_disturb_tube(tube, error, random) for tube in self.robot.tubes))

    def draw_load(self, random: np.random.Generator) -> Array:
        """Draw a wrench (6,) with a force in any direction [N] and no moment."""
        direction = random.normal(size=3)
        size = self.setting.load * random.uniform()
        return np.concatenate((direction * (size / np.linalg.norm(direction)), np.zeros(3)))

    def draw_pose(self, random: np.random.Generator) -> Array:
        """Draw valid joint positions (n,) inside the travel, at most half a turn from zero."""
        lower = np.where(self.slides, self.lower, np.maximum(self.lower, -np.pi))
        upper = np.where(self.slides, self.upper, np.minimum(self.upper, np.pi))
        for _ in range(MAX_DRAWS):
            joints = random.uniform(lower, upper)
            if self.robot.is_valid_pose(joints) and bool((self._clearance(joints[None]) >= 0.0).all()):
                return joints
        raise ConfigError(
            f"robot '{self.robot.name}': almost no joint position is valid (tubes collide): check lengths and travel"
        )

    def put(self, row: int, robot: Robot, joints: Array, wrench: Array) -> Array:
        """Put a robot at the first pose of `joints` (m, n); return its tips (m, 3) at all poses [m], NaN: no shape."""
        self.robots[row] = robot
        self.shapes.replace(row, robot)
        tips = self.shapes.solve_from_rest(row, joints, wrench)
        self.joints[row], self.wrenches[row], self.tips[row] = joints[0], wrench, tips[0]
        return tips

    def move(self, actions: Array) -> None:
        """Move all robots by actions (k, n) for a period; a robot whose next pose has no shape keeps its pose."""
        to = _moved(self.joints, actions, self._bounds)
        if self._order[1].size:
            to = self._in_order(to)
        tips, lost = self.shapes.follow(to, self.wrenches)
        if lost:
            to[lost], tips[lost] = self.joints[lost], self.tips[lost]
        self.joints, self.tips = to, tips

    @property
    def observation_bounds(self) -> Array:
        """Largest absolute values of the elements of an observation (m,)."""
        return np.concatenate((np.ones(self.lower.size + np.count_nonzero(~self.slides)), self.reach))

    def observe(self) -> Array:
        """Return the observations of all robots (k, m).

        An observation has cosine and sine of each rotation joint, the position of each translation joint scaled to
        -1 ... 1, and the tip [m].
        """
        observations = np.empty((self.rows, self._width))
        self.observe_into(observations)
        return observations

    def observe_into(self, observations: Array) -> None:
        """Write the observations of all robots into the first m columns of an array."""
        _observe(self.joints, self.tips, self._slides, self._bounds, observations)

    def _clearance(self, joints: Array) -> Array:
        """Return distances (k, m) [m] between ends of neighbouring tubes; negative if the ends passed each other."""
        matrix, bound = self._order
        return bound - MIN_TUBE_DISTANCE_M - joints @ matrix.T

    def _in_order(self, to: Array) -> Array:
        """Return the next joints `to`, with translations stopped before the ends of two tubes pass each other."""
        clearance, after = self._clearance(self.joints), self._clearance(to)
        if not (after < 0.0).any():
            return to
        with np.errstate(divide="ignore", invalid="ignore"):
            parts = np.where(after < 0.0, clearance / (clearance - after), 1.0)
        part = np.nan_to_num(parts).clip(0.0, 1.0).min(axis=1, keepdims=True)
        part = np.where(part < 1.0, (part - 1e-6).clip(0.0, 1.0), part)  # 1e-6: for rounding errors
        return np.where(self.slides, self.joints + part * (to - self.joints), to)


@compiled
def _moved(joints: Array, actions: Array, bounds: Array) -> Array:
    """Return the joints after a period, within their travel. In numpy this would take longer than a model solution."""
    to = np.empty_like(joints)
    for row in range(joints.shape[0]):
        for j in range(joints.shape[1]):
            part = min(max(actions[row, j], -1.0), 1.0)
            to[row, j] = min(max(joints[row, j] + part * bounds[2, j], bounds[0, j]), bounds[1, j])
    return to


@compiled
def _observe(joints: Array, tips: Array, slides: Indices, bounds: Array, observations: Array) -> None:
    """See `RobotBatch.observe`."""
    for row in range(joints.shape[0]):
        at = 0
        for j in range(joints.shape[1]):
            if slides[j]:
                along = (2.0 * joints[row, j] - bounds[0, j] - bounds[1, j]) / (bounds[1, j] - bounds[0, j])
                observations[row, at] = min(max(along, -1.0), 1.0)
                at += 1
            else:
                observations[row, at], observations[row, at + 1] = np.cos(joints[row, j]), np.sin(joints[row, j])
                at += 2
        for k in range(3):
            observations[row, at + k] = tips[row, k]


def _disturb_tube(tube: Tube, error: float, random: np.random.Generator) -> Tube:
    stiffness, curvature = 1.0 + error * random.uniform(-1.0, 1.0, 2)
    torsional = None if tube.torsional_stiffness is None else float(tube.torsional_stiffness * stiffness)
    sections = tuple(
        Section(section.length, (float(curvature * section.curvature[0]), float(curvature * section.curvature[1])))
        for section in tube.sections
    )
    return replace(
        tube,
        bending_stiffness=float(tube.bending_stiffness * stiffness),
        torsional_stiffness=torsional,
        sections=sections,
    )


class Actions(Box):
    """Gymnasium `Box` with a faster method `sample`, which is possible because all bounds are finite."""

    def __init__(self, joints: int) -> None:
        super().__init__(-1.0, 1.0, (joints,), dtype=np.float64)

    def sample(self, mask: None = None, probability: None = None) -> Array:
        """Return a random action, bit for bit the action that `Box.sample` would return.

        `Box.sample` takes as long as two solutions of the model.
        """
        if mask is not None or probability is not None:
            return super().sample(mask, probability)  # `Box.sample` refuses these arguments and gives the reason
        return 2.0 * self.np_random.random(self.shape) - 1.0
