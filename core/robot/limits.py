"""What the joints may do: speed, travel and the distance it takes to stop; and limits beyond single joints.

A limit beyond single joints (tube order, workspace, force) allows joint velocities v with
rows @ v <= room. Its room is what is left divided by `APPROACH`, so that it is closed in on ever more
slowly and never passed; no limit ever demands a motion.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from core.compiled import compiled
from core.errors import DescriptionError, PoseError
from core.robot.robot import Array, Robot

#: Time constant of closing in on a limit [s]; several times the delay of the stages.
APPROACH = 0.25
#: Left between tubes that are in each other's way [m]: stages are told one after the other, and go on meanwhile.
APART = 5e-4


class Situation(Protocol):
    """Where the robot is when limits are asked what they allow; what none of them asks for is not looked up."""

    @property
    def joints(self) -> Array:
        """(n,) [rad or m]."""
        ...

    @property
    def jacobian(self) -> Array:
        """(3, n) of the loaded tip [m/rad or m/m]."""
        ...

    @property
    def tip(self) -> Array:
        """(3,) [m]."""
        ...

    @property
    def force(self) -> Array:
        """(3,) on the tip, world frame [N]."""
        ...


class At(NamedTuple):
    """A situation whose parts are all known; as `Situation` has them."""

    joints: Array
    jacobian: Array
    tip: Array
    force: Array


class Limit(Protocol):
    """A limit beyond single joints."""

    @property
    def names(self) -> tuple[str, ...]:
        """What each row says when it is active, with value and unit."""
        ...

    def rows(self, at: Situation) -> tuple[Array, Array]:
        """Rows (m, n) and room (m,), none below zero: rows @ v <= room."""
        ...

    def check(self, at: Situation) -> None:
        """Raise PoseError, with value and bound, where the limit does not hold."""
        ...


@dataclass(frozen=True)
class JointLimit:
    """Limits of one joint, in its own unit (rad or m)."""

    name: str
    unit: str
    lower: float
    upper: float
    speed: float  #: per second
    acceleration: float  #: per second squared

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower < self.upper):
            raise DescriptionError(f"{self.name}: travel {self.lower:g} ... {self.upper:g} {self.unit} is empty")
        for what, value, per in (("speed", self.speed, "s"), ("acceleration", self.acceleration, "s^2")):
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"{self.name}: {what} limit {value:g} {self.unit}/{per} must be greater than 0")


@dataclass(frozen=True)
class Limits:
    """Limits of all joints in the robot's order."""

    joints: tuple[JointLimit, ...]
    reaction: float = 0.075  #: time from a command to its effect, counted as travel still to come [s]
    others: tuple[Limit, ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.reaction) and self.reaction >= 0.0):
            raise DescriptionError(f"reaction {self.reaction:g} s must be finite and at least 0")

    @cached_property
    def _arrays(self) -> tuple[Array, Array, Array, Array]:
        rows = [(j.lower, j.upper, j.speed, j.acceleration) for j in self.joints]
        lower, upper, speed, acceleration = np.array(rows).T.copy()
        return lower, upper, speed, acceleration

    @cached_property
    def packed(self) -> Array:
        """(5, n) lower and upper end of travel, speed, acceleration, and the reaction time [SI units]."""
        last = np.full(len(self.joints), self.reaction)
        return np.stack((*self._arrays, last))

    @property
    def speed(self) -> Array:
        """(n,) [rad/s or m/s]."""
        return self._arrays[2]

    @cached_property
    def order(self) -> tuple[Array, Array]:
        """Rows (m, n) and bounds (m,) of the tubes' order [m]; none where the joints' travel sees to it."""
        found = next((limit for limit in self.others if isinstance(limit, TubeOrder)), None)
        return (np.empty((0, len(self.joints))), np.empty(0)) if found is None else (found.matrix, found.bound)

    def check(self, joints: Array) -> None:
        """Raise PoseError when a position (n,) is not finite or outside its travel."""
        for limit, value in zip(self.joints, joints, strict=True):
            if not limit.lower <= value <= limit.upper:
                raise PoseError(
                    f"{limit.name} {value:.4g} {limit.unit} is outside"
                    f" {limit.lower:.4g} ... {limit.upper:.4g} {limit.unit} (its travel)"
                )

    def velocity_bounds(self, joints: Array) -> tuple[Array, Array]:
        """Lowest and highest velocity (n,) from which each joint can still stop inside its travel."""
        return velocity_bounds(joints, self.packed)

    def rows(self, at: Situation) -> tuple[Array, Array]:
        """All limits beyond single joints: rows (m, n) and room (m,)."""
        parts = [limit.rows(at) for limit in self.others]
        if len(parts) == 1:
            return parts[0]
        return np.concatenate([rows for rows, _ in parts]), np.concatenate([room for _, room in parts])

    def blocking(self, joints: Array, at_bound: Array, at_row: Array) -> bool:
        """Whether a limit other than a joint's speed shaped a command; arguments as of `active`."""
        if not at_bound.any() and not at_row.any():
            return False
        lower, upper = self.velocity_bounds(joints)
        near_end = np.where(at_bound > 0.0, upper, -lower) < self.speed
        return bool(at_row.any() or (near_end & (at_bound != 0.0)).any())

    def active(self, joints: Array, at_bound: Array, at_row: Array) -> tuple[str, ...]:
        """The limits that shaped a command, in words.

        Args:
            joints: (n,) [rad or m].
            at_bound: (n,) -1, 0 or 1: at the lower bound of its velocity, free, at the upper.
            at_row: (m,) 1 where a row is active.

        """
        lower, upper = self.velocity_bounds(joints)
        found: list[str] = []
        for limit, side, slowest, fastest in zip(self.joints, at_bound, lower, upper, strict=True):
            end, bound = (limit.upper, fastest) if side > 0.0 else (limit.lower, -slowest)
            if side != 0.0 and bound < limit.speed:
                found.append(f"travel of {limit.name} ({end:.4g} {limit.unit})")
            elif side != 0.0:
                found.append(f"speed of {limit.name} ({limit.speed:.4g} {limit.unit}/s)")
        names = [name for limit in self.others for name in limit.names]
        return (*found, *(name for name, active in zip(names, at_row, strict=False) if active))


@dataclass(frozen=True)
class TubeOrder:
    """Tubes stay in order: no tube starts in front of, or ends inside, the next outer one."""

    names: tuple[str, ...]
    matrix: Array  #: (m, n)
    bound: Array  #: (m,) matrix @ joints <= bound [m]

    @classmethod
    def of(cls, robot: Robot, joints: tuple[JointLimit, ...]) -> "TubeOrder | None":
        """The order of a robot's tubes as far as its joints' travel does not see to it already; None when it does."""
        slides = {joint.tube: k for k, joint in enumerate(robot.joints) if joint.motion == "translation"}
        names: list[str] = []
        rows: list[Array] = []
        bounds: list[float] = []

        def keep(name: str, behind: int, front: int | None, bound: float) -> None:
            """Proximal end of tube `behind` - that of `front` <= bound."""
            row, most = np.zeros(len(joints)), 0.0
            for tube, sign in ((behind, 1.0), (front, -1.0)):
                if tube in slides:
                    k = slides[tube]
                    row[k] = sign
                    most += sign * (joints[k].upper if sign > 0.0 else joints[k].lower)
            if most > bound:
                names.append(name)
                rows.append(row)
                bounds.append(bound)

        for i, tube in enumerate(robot.tubes):
            outer = i + 1 if i + 1 < len(robot.tubes) else None
            around = "the plate" if outer is None else f"tube '{robot.tubes[outer].name}'"
            keep(f"start of tube '{tube.name}' behind that of {around}", i, outer, 0.0)
            # end of the outer - end of this one <= 0, the other way round
            if outer is None:
                slide = slides.get(i)
                if slide is not None and joints[slide].lower < -tube.length:
                    row = np.zeros(len(joints))
                    row[slide] = -1.0
                    names.append(f"end of tube '{tube.name}' in front of the plate")
                    rows.append(row)
                    bounds.append(tube.length)
            else:
                longer = tube.length - robot.tubes[outer].length
                keep(f"end of tube '{tube.name}' beyond that of {around}", outer, i, longer)
        return cls(tuple(names), np.array(rows), np.array(bounds)) if names else None

    def rows(self, at: Situation) -> tuple[Array, Array]:
        """Each pair closes in on the other ever more slowly, as far as `APART`."""
        return self.matrix, _room(self.matrix, self.bound, at.joints)

    def check(self, at: Situation) -> None:
        """Raise PoseError for the first pair out of order."""
        over = self.matrix @ at.joints - self.bound
        for name, value in zip(self.names, over, strict=True):
            if value > 0.0:
                raise PoseError(f"tube order: {name} does not hold, by {1e3 * value:.3g} mm")


@dataclass(frozen=True)
class Workspace:
    """The tip stays inside a box."""

    lower: tuple[float, float, float]  #: world frame [m]
    upper: tuple[float, float, float]  #: [m]

    def __post_init__(self) -> None:
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if not low < high:
                raise DescriptionError(f"workspace: {axis} {low:g} ... {high:g} m is empty")

    @property
    def names(self) -> tuple[str, ...]:
        """A face each."""
        high = [f"workspace {axis} <= {bound:g} m" for axis, bound in zip("xyz", self.upper, strict=True)]
        return (*high, *(f"workspace {axis} >= {bound:g} m" for axis, bound in zip("xyz", self.lower, strict=True)))

    def rows(self, at: Situation) -> tuple[Array, Array]:
        """No faster toward a face than the way to it over `APPROACH`."""
        room = np.concatenate((self.upper - at.tip, at.tip - self.lower))
        return np.concatenate((at.jacobian, -at.jacobian)), np.maximum(room, 0.0) / APPROACH

    def check(self, at: Situation) -> None:
        """Raise PoseError for a tip outside."""
        for axis, low, value, high in zip("xyz", self.lower, at.tip, self.upper, strict=True):
            if not low <= value <= high:
                raise PoseError(f"tip {axis} {value:.4g} m is outside {low:g} ... {high:g} m (the workspace)")


@dataclass(frozen=True)
class ForceLimit:
    """The tip does not push on against a load that is as large as allowed."""

    most: float  #: [N]
    speed: float = 0.005  #: against the load while there is none; less in proportion as it grows [m/s]

    def __post_init__(self) -> None:
        for name, value, unit in (("most", self.most, "N"), ("speed", self.speed, "m/s")):
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"force limit: {name} {value:g} {unit} must be finite and greater than 0")

    @property
    def names(self) -> tuple[str, ...]:
        """The one row."""
        return (f"force on the tip ({self.most:g} N)",)

    def rows(self, at: Situation) -> tuple[Array, Array]:
        """-F/|F| . J v <= speed (1 - |F| / most)."""
        force = float(np.linalg.norm(at.force))
        if force < 1e-9:
            return np.zeros((1, at.joints.shape[0])), np.ones(1)
        against = -(at.force / force) @ at.jacobian
        return against[None, :], np.array([self.speed * max(0.0, 1.0 - force / self.most)])

    def check(self, at: Situation) -> None:
        """Raise PoseError when the load is larger already."""
        force = float(np.linalg.norm(at.force))
        if force > self.most:
            raise PoseError(f"force on the tip {force:.3g} N is above {self.most:g} N (its limit)")


@compiled
def _room(matrix: Array, bound: Array, joints: Array) -> Array:
    """What is left of matrix @ joints <= bound - `APART`, none below zero, over `APPROACH`."""
    room = np.empty(bound.shape[0])
    for i in range(bound.shape[0]):
        left = bound[i] - APART
        for j in range(joints.shape[0]):
            left -= matrix[i, j] * joints[j]
        room[i] = max(left, 0.0) / APPROACH
    return room


@compiled
def velocity_bounds(joints: Array, limits: Array) -> tuple[Array, Array]:
    """`Limits.velocity_bounds` for `Limits.packed`."""
    lower, upper, speed, acceleration, reaction = limits[0], limits[1], limits[2], limits[3], limits[4, 0]
    lowest, highest = np.empty_like(joints), np.empty_like(joints)
    for i in range(joints.shape[0]):
        lag = acceleration[i] * reaction
        lowest[i] = -min(speed[i], _braking(joints[i] - lower[i], acceleration[i], lag))
        highest[i] = min(speed[i], _braking(upper[i] - joints[i], acceleration[i], lag))
    return lowest, highest


@compiled
def _braking(room: float, acceleration: float, lag: float) -> float:
    """Largest v with v * reaction + v^2 / (2 a) <= room; `lag` is a * reaction."""
    if not room > 0.0:  # NaN included: min and max would let it pass as full speed
        return 0.0
    return np.sqrt(lag * lag + 2.0 * acceleration * room) - lag
