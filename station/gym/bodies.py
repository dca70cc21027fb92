"""k robots that are moved by actions within their limits, each with hidden faults of its tubes and a hidden load."""

from dataclasses import dataclass, replace

import numpy as np

from core.compiled import compiled
from core.robot.robot import Array, Indices, Robot, Section, Tube
from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.gym.shapes import ExactShapes, LoadedShapes, Shapes

#: Left between tubes that are in each other's way [m].
RESERVE = 1e-9
#: Draws of a pose before a robot file is given up.
MOST_DRAWS = 10_000

Bools = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


@dataclass(frozen=True)
class Setting:
    """What is moved, and what is hidden from whoever moves it."""

    robot: str = "paper"  #: preset or .toml file
    load: float = 0.2  #: largest force at the tip, in any direction [N]
    tube_error: float = 0.0  #: largest relative error of each tube's stiffness and curvatures
    exact: bool = False  #: the exact rod instead of the loaded model
    period: float = 0.1  #: of an action [s]

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("load", self.load, 0.0, 100.0),
            ("tube_error", self.tube_error, 0.0, 0.5),
            ("period", self.period, 1e-4, 10.0),
        ):
            if not low <= value <= high:
                raise ConfigError(f"{name} = {value:g} is outside {low:g} ... {high:g}")


class Bodies:
    """The robots; an action is a part, -1 ... 1, of every joint's speed."""

    def __init__(self, setting: Setting, rows: int) -> None:
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
        #: In each direction the tip is never further from the world's origin [m].
        self.reach: Array = base + self.robot.tubes[0].length
        self.shapes: Shapes = (ExactShapes if setting.exact else LoadedShapes)(self.robot, rows)
        self.robots = [self.robot] * rows
        self._width = self.felt_bounds.size
        self.joints, self.wrenches = np.zeros((rows, self.lower.size)), np.zeros((rows, 6))
        self.tips = np.zeros((rows, 3))

    def disturbed(self, random: np.random.Generator) -> Robot:
        """The robot with tubes that are not quite as described."""
        error = self.setting.tube_error
        if error == 0.0:
            return self.robot
        return replace(self.robot, tubes=tuple(_disturbed(tube, error, random) for tube in self.robot.tubes))

    def drawn_load(self, random: np.random.Generator) -> Array:
        """A force (6,) in any direction [N]."""
        direction = random.normal(size=3)
        size = self.setting.load * random.uniform()
        return np.concatenate((direction * (size / np.linalg.norm(direction)), np.zeros(3)))

    def drawn_pose(self, random: np.random.Generator) -> Array:
        """Joints (n,) anywhere in their travel where the tubes stand, at most half a turn from zero."""
        lower = np.where(self.slides, self.lower, np.maximum(self.lower, -np.pi))
        upper = np.where(self.slides, self.upper, np.minimum(self.upper, np.pi))
        for _ in range(MOST_DRAWS):
            joints = random.uniform(lower, upper)
            if self.robot.stands(joints) and bool((self._room(joints[None]) >= 0.0).all()):
                return joints
        raise ConfigError(f"robot '{self.robot.name}': its tubes stand hardly anywhere in the travel of its joints")

    def put(self, row: int, robot: Robot, joints: Array, wrench: Array) -> Array:
        """A robot at the first of the poses (m, n); the tips (m, 3) of all of them, NaN where there is no shape."""
        self.robots[row] = robot
        self.shapes.replace(row, robot)
        tips = self.shapes.look(row, joints, wrench)
        self.joints[row], self.wrenches[row], self.tips[row] = joints[0], wrench, tips[0]
        return tips

    def move(self, actions: Array) -> None:
        """Move all robots on by actions (k, n) for a period; one that would have no shape stays where it was."""
        to = _moved(self.joints, actions, self._bounds)
        if self._order[1].size:
            to = self._in_order(to)
        tips, lost = self.shapes.follow(to, self.wrenches)
        if lost:
            to[lost], tips[lost] = self.joints[lost], self.tips[lost]
        self.joints, self.tips = to, tips

    @property
    def felt_bounds(self) -> Array:
        """How large each part of what is felt may be (m,)."""
        return np.concatenate((np.ones(self.lower.size + np.count_nonzero(~self.slides)), self.reach))

    def felt(self) -> Array:
        """What is known of the robots (k, m): cosine and sine, or -1 ... 1 of its travel, of each joint; the tip."""
        felt = np.empty((self.rows, self._width))
        self.feel(felt)
        return felt

    def feel(self, felt: Array) -> None:
        """The same, written into the first m columns of an array."""
        _felt(self.joints, self.tips, self._slides, self._bounds, felt)

    def _room(self, joints: Array) -> Array:
        """What is left between the tubes (k, m) [m]."""
        matrix, bound = self._order
        return bound - RESERVE - joints @ matrix.T

    def _in_order(self, to: Array) -> Array:
        """The translations stop, all of them, where tubes would get in each other's way."""
        room, after = self._room(self.joints), self._room(to)
        if not (after < 0.0).any():
            return to
        with np.errstate(divide="ignore", invalid="ignore"):
            parts = np.where(after < 0.0, room / (room - after), 1.0)
        part = np.nan_to_num(parts).clip(0.0, 1.0).min(axis=1, keepdims=True)
        part = np.where(part < 1.0, (part - 1e-6).clip(0.0, 1.0), part)  # and not a rounding error beyond it
        return np.where(self.slides, self.joints + part * (to - self.joints), to)


@compiled
def _moved(joints: Array, actions: Array, bounds: Array) -> Array:
    """Joints after a period, within their travel; numpy's own functions take longer than a solve for one row."""
    to = np.empty_like(joints)
    for row in range(joints.shape[0]):
        for j in range(joints.shape[1]):
            part = min(max(actions[row, j], -1.0), 1.0)
            to[row, j] = min(max(joints[row, j] + part * bounds[2, j], bounds[0, j]), bounds[1, j])
    return to


@compiled
def _felt(joints: Array, tips: Array, slides: Indices, bounds: Array, felt: Array) -> None:
    """See `Bodies.felt`."""
    for row in range(joints.shape[0]):
        at = 0
        for j in range(joints.shape[1]):
            if slides[j]:
                along = (2.0 * joints[row, j] - bounds[0, j] - bounds[1, j]) / (bounds[1, j] - bounds[0, j])
                felt[row, at] = min(max(along, -1.0), 1.0)
                at += 1
            else:
                felt[row, at], felt[row, at + 1] = np.cos(joints[row, j]), np.sin(joints[row, j])
                at += 2
        for k in range(3):
            felt[row, at + k] = tips[row, k]


def _disturbed(tube: Tube, error: float, random: np.random.Generator) -> Tube:
    stiffer, rounder = 1.0 + error * random.uniform(-1.0, 1.0, 2)
    torsional = None if tube.torsional_stiffness is None else float(tube.torsional_stiffness * stiffer)
    sections = tuple(
        Section(section.length, (float(rounder * section.curvature[0]), float(rounder * section.curvature[1])))
        for section in tube.sections
    )
    return replace(
        tube,
        bending_stiffness=float(tube.bending_stiffness * stiffer),
        torsional_stiffness=torsional,
        sections=sections,
    )
