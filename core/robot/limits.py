"""Limits of single joints (speed, travel, stopping distance) and limits of several joints together.

A limit of several joints (tube order, workspace, force) allows joint velocities v with G @ v <= h. `Limit.rows` returns
the matrix G (the rows) and the vector h (the room). For tube order and workspace, h is the remaining distance divided
by `BRAKING_TIME_CONSTANT_S`, so the robot approaches the limit ever more slowly and never passes it. For the force, h
is a tip speed that falls to 0 at the largest force. No limit ever requires a motion: zero velocity is always allowed.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from core.compiled import compiled
from core.contract import name_of, numbers, pair, result_of
from core.errors import ContractError, DescriptionError, PoseError
from core.robot.robot import FLUSH_TOLERANCE_M, Array, Robot, positive

#: Time constant with which the robot approaches a limit [s]; it is several times the delay of the stages.
BRAKING_TIME_CONSTANT_S = 0.25
#: Smallest distance between tubes that could collide [m]; it is needed because stages keep moving between commands.
MIN_TUBE_DISTANCE_M = 5e-4

T = TypeVar("T")


class Backbone(NamedTuple):
    """Points along the loaded tubes from the plate to the last tube end, world frame."""

    points: Array  #: (m, 3) positions on the centre line [m]
    radii: Array  #: (m,) radius of the outermost tube at each point [m]
    jacobian: Array  #: (m, 3, n) derivative of each point by the joints [m/rad or m/m]
    drift: Array  #: (m, 3) velocity of each point that the joints do not cause [m/s]
    ahead: Array  #: (m, 3) displacement of each point until a command sent now takes effect [m]
    along: int  #: number of points from the plate to the last tube end; the points after them are other tubes' ends


class LimitContext(Protocol):
    """State of the robot for which limits are evaluated; properties that no limit reads are not computed."""

    @property
    def joints(self) -> Array:
        """Joint positions (n,) [rad or m]."""
        ...

    @property
    def jacobian(self) -> Array:
        """Jacobian (3, n) of the loaded tip's position [m/rad or m/m]."""
        ...

    @property
    def tip(self) -> Array:
        """Position of the tip (3,), world frame [m]."""
        ...

    @property
    def force(self) -> Array:
        """Force on the tip (3,), world frame [N]."""
        ...

    @property
    def backbone(self) -> Backbone:
        """Points along the loaded tubes."""
        ...


class Configuration(NamedTuple):
    """A `LimitContext` whose values were all computed beforehand."""

    joints: Array
    jacobian: Array
    tip: Array
    force: Array
    backbone: Backbone = Backbone(
        np.empty((0, 3)), np.empty(0), np.empty((0, 3, 0)), np.empty((0, 3)), np.empty((0, 3)), 0
    )


class Limit(Protocol):
    """A limit of several joints together, for example the workspace."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each row, with its bound and unit; reports show the name while the row limits the motion."""
        ...

    def rows(self, at: LimitContext) -> tuple[Array, Array]:
        """Return rows G (m, n) and room h (m,), h >= 0: joint velocities v must satisfy G @ v <= h."""
        ...

    def check(self, at: LimitContext) -> None:
        """Raise PoseError, with value and bound, if the robot's state violates the limit."""
        ...


@dataclass(frozen=True)
class JointLimit:
    """Limits of one joint, in the joint's unit (rad or m)."""

    name: str
    unit: str
    lower: float
    upper: float
    speed: float  #: largest speed [rad/s or m/s]
    acceleration: float  #: largest acceleration [rad/s^2 or m/s^2]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower < self.upper):
            raise DescriptionError(f"{self.name}: travel {self.lower:g} ... {self.upper:g} {self.unit} is empty")
        for what, value, per in (("speed", self.speed, "s"), ("acceleration", self.acceleration, "s^2")):
            if not (math.isfinite(value) and value > 0.0):
                raise DescriptionError(f"{self.name}: {what} limit {value:g} {self.unit}/{per} must be greater than 0")


class ForceBound(NamedTuple):
    """The largest force on the tip at which a motion continues."""

    newton: float  #: largest size of the force [N]
    reason: str  #: text that names the part that the bound protects


@dataclass(frozen=True)
class Limits:
    """Limits of all joints in the robot's order."""

    joints: tuple[JointLimit, ...]
    reaction: float = 0.075  #: time from a command to its effect, during which the joint keeps moving [s]
    others: tuple[Limit, ...] = ()  #: limits of several joints together
    overload: ForceBound | None = None  #: force above which a motion stops; this bound does not limit velocities
    #: order of the tubes that searches and redundant joints keep; it limits motions only if `others` contains it, too
    tube_order: "TubeOrder | None" = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.reaction) and self.reaction >= 0.0):
            raise DescriptionError(f"reaction time {self.reaction:g} s must be finite and at least 0")

    @cached_property
    def packed(self) -> Array:
        """Rows (5, n): lower and upper end of travel, top speed, acceleration, and reaction time [SI units]."""
        return np.array([(j.lower, j.upper, j.speed, j.acceleration, self.reaction) for j in self.joints]).T.copy()

    @property
    def speed(self) -> Array:
        """Top speeds of the joints (n,) [rad/s or m/s]."""
        return self.packed[2]

    @cached_property
    def order(self) -> tuple[Array, Array]:
        """Rows (m, n) and bounds (m,) of the tube order [m]; empty where the joints' travel ensures the order."""
        return self._order_rows(self.tube_order)

    @cached_property
    def required_order(self) -> tuple[Array, Array]:
        """Rows and bounds of the tube order that limits motions; empty if the order does not limit them."""
        return self._order_rows(next((limit for limit in self.others if isinstance(limit, TubeOrder)), None))

    def _order_rows(self, order: "TubeOrder | None") -> tuple[Array, Array]:
        return (np.empty((0, len(self.joints))), np.empty(0)) if order is None else (order.matrix, order.bound)

    def check(self, joints: Array) -> None:
        """Raise PoseError when a position (n,) is not finite or outside its travel."""
        for limit, value in zip(self.joints, joints, strict=True):
            if not limit.lower <= value <= limit.upper:
                raise PoseError(
                    f"{limit.name} {value:.4g} {limit.unit} is outside"
                    f" {limit.lower:.4g} ... {limit.upper:.4g} {limit.unit} (its travel)"
                )

    def check_all(self, at: LimitContext) -> None:
        """Check the travel of every joint and every limit of several joints at the robot's state.

        Raises:
            PoseError: a limit is violated; the text has the limit's name, the value and the bound.
            ContractError: a custom limit raised another error, or its rows violate the interface `Limit`.

        """
        self.check(at.joints)
        for limit in self.others:
            if type(limit) in _BUILT_IN_LIMITS:
                limit.check(at)
                continue
            try:
                result_of(f"limit '{name_of(limit)}'", limit.check, at)
            except ContractError as error:
                raise error.__cause__ if isinstance(error.__cause__, PoseError) else error from None
            _rows_of(limit, at)

    def velocity_bounds(self, joints: Array) -> tuple[Array, Array]:
        """Return the lowest and highest velocity (n,) from which each joint can still stop inside its travel."""
        return velocity_bounds(joints, self.packed)

    def rows(self, at: LimitContext) -> tuple[Array, Array]:
        """Return rows (m, n) and room (m,) of all limits of several joints.

        Raises:
            ContractError: a custom limit raised, or returned a wrong shape, a number that is not finite or a negative
                room.

        """
        parts = [limit.rows(at) if type(limit) in _BUILT_IN_LIMITS else _rows_of(limit, at) for limit in self.others]
        if len(parts) == 1:
            return parts[0]
        return np.concatenate([rows for rows, _ in parts]), np.concatenate([room for _, room in parts])

    def blocking(self, joints: Array, at_bound: Array, at_row: Array) -> bool:
        """Return whether a limit other than a joint's top speed changed a command; for the arguments see `active`."""
        if not at_bound.any() and not at_row.any():
            return False
        lower, upper = self.velocity_bounds(joints)
        near_end = np.where(at_bound > 0.0, upper, -lower) < self.speed
        return bool(at_row.any() or (near_end & (at_bound != 0.0)).any())

    def active(self, joints: Array, at_bound: Array, at_row: Array) -> tuple[str, ...]:
        """Return the names of the limits that changed a command.

        Args:
            joints: joint positions (n,) [rad or m].
            at_bound: (n,) -1: joint velocity at its lower bound; 0: free; 1: at its upper bound.
            at_row: (m,) 1 where a limit of several joints is active.

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
        return (*found, *dict.fromkeys(name for name, active in zip(names, at_row, strict=False) if active))


@dataclass(frozen=True)
class TubeOrder:
    """Limit of the tube order: no tube starts in front of the next outer tube, or ends behind the plate.

    If required, no tube ends inside the next outer tube, either.
    """

    names: tuple[str, ...]
    matrix: Array  #: (m, n) coefficients of the joint positions
    bound: Array  #: (m,) bounds: matrix @ joints <= bound [m]

    @classmethod
    def of(cls, robot: Robot, joints: tuple[JointLimit, ...], ends: bool = True) -> "TubeOrder | None":
        """Return the tube order limit of a robot; None if the joints' travel already ensures the order.

        `ends`: whether every tube has to end beyond the tube around it.
        """
        slides = {joint.tube: k for k, joint in enumerate(robot.joints) if joint.motion == "translation"}
        names: list[str] = []
        rows: list[Array] = []
        bounds: list[float] = []

        def keep(name: str, behind: int, front: int | None, bound: float) -> None:
            """Add the row: proximal end of tube `behind` minus proximal end of tube `front` <= bound."""
            row, largest = np.zeros(len(joints)), 0.0
            for tube, sign in ((behind, 1.0), (front, -1.0)):
                if tube in slides:
                    k = slides[tube]
                    row[k] = sign
                    largest += sign * (joints[k].upper if sign > 0.0 else joints[k].lower)
            if largest > bound:
                names.append(name)
                rows.append(row)
                bounds.append(bound)

        for i, tube in enumerate(robot.tubes):
            outer = i + 1 if i + 1 < len(robot.tubes) else None
            around = "the plate" if outer is None else f"tube '{robot.tubes[outer].name}'"
            keep(f"start of tube '{tube.name}' behind that of {around}", i, outer, 0.0)
            # Row: end of the outer tube minus end of this tube <= 0.
            if outer is None:
                slide = slides.get(i)
                if slide is not None and joints[slide].lower < -tube.length:
                    row = np.zeros(len(joints))
                    row[slide] = -1.0
                    names.append(f"end of tube '{tube.name}' in front of the plate")
                    rows.append(row)
                    bounds.append(tube.length)
            elif ends:
                longer = tube.length - robot.tubes[outer].length
                keep(f"end of tube '{tube.name}' beyond that of {around}", outer, i, longer)
        return cls(tuple(names), np.array(rows), np.array(bounds)) if names else None

    def rows(self, at: LimitContext) -> tuple[Array, Array]:
        """Return rows that slow down the approach of two tube ends and stop it at `MIN_TUBE_DISTANCE_M`."""
        room = np.empty(self.bound.size)
        _distances(self.matrix, self.bound, at.joints, room)
        return self.matrix, room

    def check(self, at: LimitContext) -> None:
        """Raise PoseError for the first pair of tubes that violates the order."""
        over = self.matrix @ at.joints - self.bound
        for name, value in zip(self.names, over, strict=True):
            if value > FLUSH_TOLERANCE_M:
                raise PoseError(f"tube order is violated by {1e3 * value:.3g} mm; required: {name}")


@dataclass(frozen=True)
class Workspace:
    """Limit that keeps the tip inside a box."""

    lower: tuple[float, float, float]  #: lower corner of the box, world frame [m]
    upper: tuple[float, float, float]  #: upper corner of the box, world frame [m]

    def __post_init__(self) -> None:
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if not low < high:
                raise DescriptionError(f"workspace: {axis} {low:g} ... {high:g} m is empty")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the rows: one for each face of the box, with its bound."""
        high = [f"workspace {axis} <= {bound:g} m" for axis, bound in zip("xyz", self.upper, strict=True)]
        return (*high, *(f"workspace {axis} >= {bound:g} m" for axis, bound in zip("xyz", self.lower, strict=True)))

    def rows(self, at: LimitContext) -> tuple[Array, Array]:
        """Return rows that limit the speed toward a face to its distance over `BRAKING_TIME_CONSTANT_S`."""
        room = np.concatenate((self.upper - at.tip, at.tip - self.lower))
        return np.concatenate((at.jacobian, -at.jacobian)), np.maximum(room, 0.0) / BRAKING_TIME_CONSTANT_S

    def check(self, at: LimitContext) -> None:
        """Raise PoseError for a tip outside the box."""
        for axis, low, value, high in zip("xyz", self.lower, at.tip, self.upper, strict=True):
            if not low <= value <= high:
                raise PoseError(f"tip {axis} {value:.4g} m is outside {low:g} ... {high:g} m (the workspace)")


@dataclass(frozen=True)
class ForceLimit:
    """Limit of the tip's speed against a load; at the largest allowed force the tip must not move against the load."""

    max_force: float  #: largest allowed force on the tip [N]
    speed: float = 0.005  #: largest speed against a vanishing load; it falls linearly to 0 at `max_force` [m/s]

    def __post_init__(self) -> None:
        for name, value, unit in (("max_force", self.max_force, "N"), ("speed", self.speed, "m/s")):
            positive(f"force limit: {name}", value, unit)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of the single row of this limit."""
        return (f"force on the tip ({self.max_force:g} N)",)

    def rows(self, at: LimitContext) -> tuple[Array, Array]:
        """Return the row -F/|F| . J v <= speed (1 - |F| / max_force) for force F, Jacobian J and joint velocities v."""
        force = float(np.linalg.norm(at.force))
        if force < 1e-9:
            return np.zeros((1, at.joints.shape[0])), np.ones(1)
        against = -(at.force / force) @ at.jacobian
        return against[None, :], np.array([self.speed * max(0.0, 1.0 - force / self.max_force)])

    def check(self, at: LimitContext) -> None:
        """Raise PoseError when the load already exceeds the limit."""
        force = float(np.linalg.norm(at.force))
        if force > self.max_force:
            raise PoseError(f"force on the tip {force:.3g} N is above {self.max_force:g} N (its limit)")


#: Types of the built-in limits; unlike those of custom limits, their rows need no check at every tick.
_BUILT_IN_LIMITS: set[type] = {TubeOrder, Workspace, ForceLimit}


def built_in(limit: type[T]) -> type[T]:
    """Register a class as built-in limit, as a class decorator."""
    _BUILT_IN_LIMITS.add(limit)
    return limit


def _rows_of(limit: Limit, at: LimitContext) -> tuple[Array, Array]:
    """Return rows (m, n) and room (m,) of a custom limit with m names, after checking them."""
    who = f"limit '{name_of(limit)}'"
    m = len(result_of(who, getattr, limit, "names"))
    matrix, bound = pair(who, result_of(who, limit.rows, at), "(rows, room)")
    rows = numbers(who, "rows", matrix, (m, at.joints.size), "per rad or m")
    room = numbers(who, "room", bound, (m,), "1/s")
    if (room < 0.0).any():
        raise ContractError(f"{who}: room is {room.tolist()}; no element may be below 0")
    return rows, room


@compiled
def _distances(matrix: Array, bound: Array, joints: Array, room: Array) -> None:
    """Compute the room of each tube order row: remaining distance (at least 0) over `BRAKING_TIME_CONSTANT_S`."""
    for i in range(bound.shape[0]):
        slack = bound[i] - MIN_TUBE_DISTANCE_M
        for j in range(joints.shape[0]):
            slack -= matrix[i, j] * joints[j]
        room[i] = max(slack, 0.0) / BRAKING_TIME_CONSTANT_S


@compiled
def velocity_bounds(joints: Array, limits: Array) -> tuple[Array, Array]:
    """Return `Limits.velocity_bounds` for limits in the form of `Limits.packed`."""
    lower, upper, speed, acceleration, reaction = limits[0], limits[1], limits[2], limits[3], limits[4, 0]
    lowest, highest = np.empty_like(joints), np.empty_like(joints)
    for i in range(joints.shape[0]):
        lag = acceleration[i] * reaction
        lowest[i] = -min(speed[i], _braking(joints[i] - lower[i], acceleration[i], lag))
        highest[i] = min(speed[i], _braking(upper[i] - joints[i], acceleration[i], lag))
    return lowest, highest


@compiled
def _braking(room: float, acceleration: float, lag: float) -> float:
    """Return the largest speed v from which a joint stops within `room`: v * reaction + v^2 / (2 a) <= room.

    `lag` is the acceleration a times the reaction time.
    """
    if not room > 0.0:  # also true for NaN, for which min and max would return full speed
        return 0.0
    return np.sqrt(lag * lag + 2.0 * acceleration * room) - lag
