"""Load on the plant, and the force of an obstacle that the plant's tip touches.

The force of a wall or a sphere depends on the true tip, and the tip depends on the force. Each tick solves both
together. If f is the obstacle's force on a tip at x, Newton's steps are

    F <- F + (I + K C)^-1 (f(x(F)) - F),    K = -df/dx,  C = dx/dF,

where C is the compliance of the fast model. A force that would pull the tip is set to zero. The steps converge for any
stiffness if the true compliance is between 0 and twice that of the model. The plant is reset before each step, so that
its friction changes only once in a tick.
"""

import math
from typing import NamedTuple

import numpy as np

from core.errors import CtrError
from core.model.solution import pure_force
from core.model.statics import Solution, Statics
from core.robot.robot import Array
from station.config.loads import MAX_FORCE_N, Load, NoLoad, Obstacle, force_of
from station.lab.frictional_plant import FrictionalPlant
from station.lab.plant import Plant, PlantState

#: Residual of the contact force at which a tick's solution is accepted [N], and largest number of Newton's steps.
TOLERANCE_N, MAX_ROUNDS = 1e-5, 12
#: Error of the plant's tip [m]. Its product with the obstacle's stiffness is a residual that no step can remove.
PLANT_ERROR_M = 2e-8
#: Interval between two computations of the compliance [s]; it changes with the pose by less than 1 % in this time.
COMPLIANCE_INTERVAL_S = 0.02


class LoadedPlant:
    """A plant with the load on it."""

    def __init__(self, plant: Plant | FrictionalPlant) -> None:
        self._plant = plant
        self._contact: TipContact | None = None
        self.apply(NoLoad(), 0.0)

    def apply(self, load: Load, start: float) -> None:
        """Apply a load; the load's time counts from `start` [s]."""
        self._load, self._start = load, start
        self._acts_at = load.contact  # arc length at which the force acts [m]; inf for the tip
        self._contact = TipContact(self._plant, load) if isinstance(load, Obstacle) else None

    def advance(self, joints: Array, now: float) -> PlantState:
        """Move the joints to `joints` (n,) and return the state of the plant under its load at `now` [s].

        Raises:
            NotFinite, NoSolution: the plant has no equilibrium shape there; it keeps its last shape.
            ContractError: a custom load raised an exception, or did not return three finite numbers.
        """
        if self._contact is not None:
            return self._contact.advance(joints, now - self._start, now)
        return self._plant.advance(joints, force_of(self._load, now - self._start), self._acts_at, now)


class TipContact:
    """Contact of a plant's tip with an obstacle, whose position is relative to the tip at the load's start."""

    def __init__(self, plant: Plant | FrictionalPlant, obstacle: Obstacle) -> None:
        self._plant, self._obstacle = plant, obstacle
        self._model = Statics(plant.robot)
        self._near: Solution | None = None
        self._compliance = np.zeros((3, 3))
        self._compliance_at = -math.inf  # time of the last computation of the compliance [s]
        self._start: Array | None = None  # tip at the load's start (3,) [m]
        self._force = np.zeros(3)
        self._depth = 0.0  # depth at the last tick [m]
        self._stuck_at: Array | None = None  # point of the surface to which friction pulls the tip (3,) [m]
        self._time = 0.0  # time of the last tick since the load's start [s]

    def advance(self, joints: Array, time: float, now: float) -> PlantState:
        """Move the joints to `joints` (n,) and return the state of the plant in contact.

        Args:
            joints: positions of the joints [rad or m].
            time: time since the load's start [s]; if it is negative, there is no contact.
            now: time [s].

        Raises:
            NotFinite, NoSolution: the plant has no equilibrium shape there; it keeps its last shape.
        """
        if time < 0.0 or self._start is None:
            state = self._plant.advance(joints, np.zeros(3), now=now)
            self._start, self._time = state.truth.tip.copy(), time
            self._depth = self._obstacle.depth(np.zeros(3), time).depth
            return state
        period = max(time - self._time, 1e-9)
        before, force = self._plant.memory(), self._force
        for _ in range(MAX_ROUNDS):
            state = self._plant.advance(joints, force, now=now)
            push = self._law(state.truth.tip - self._start, time, period)
            residual = (push.force if push.touches else _ZERO) - force
            if np.abs(residual).max() <= max(TOLERANCE_N, PLANT_ERROR_M * float(np.abs(push.slope).max())):
                break
            self._plant.restore(before)
            self._update_compliance(joints, force, now)
            step = np.linalg.solve(np.eye(3) + push.slope @ self._compliance, push.force - force)
            force = _pushing(force + step, push.normal)
        else:  # not converged, for example at `MAX_FORCE_N`: use the force of the last step
            state = self._plant.advance(joints, force, now=now)
        self._accept(state.truth.tip - self._start, force, time)
        return state

    def _update_compliance(self, joints: Array, force: Array, now: float) -> None:
        if now - self._compliance_at < COMPLIANCE_INTERVAL_S:
            return
        self._compliance_at = now
        try:
            self._near = self._model.solve(joints, pure_force(force), self._near)
        except CtrError:  # keep the last compliance; the steps converge more slowly
            self._near = None
            return
        self._compliance = self._near.compliance[:3, :3].copy()

    def _law(self, offset: Array, time: float, period: float) -> "_Push":
        """Return the force on a tip at `offset` (3,) from its start; outside the obstacle, the force is a pull."""
        obstacle = self._obstacle
        depth, normal = obstacle.depth(offset, time)
        size = obstacle.stiffness * depth + obstacle.damping * (depth - max(self._depth, 0.0)) / period
        rise = obstacle.stiffness + obstacle.damping / period
        across = np.outer(normal, normal)
        force, slope = size * normal, rise * across
        if (spot := obstacle.spot(offset)) is not None:
            size, rise = size + spot.stiffness * depth, rise + spot.stiffness
            tilt = depth * np.outer(normal, spot.gradient)
            force = size * normal - 0.5 * depth * depth * spot.gradient
            slope = rise * across - tilt - tilt.T + 0.5 * depth * depth * spot.curvature
        if obstacle.friction > 0.0 and self._stuck_at is not None and size > 0.0:
            rub = -obstacle.stiffness * (offset - self._stuck_at)
            rub -= float(rub @ normal) * normal
            length, most = float(np.linalg.norm(rub)), obstacle.friction * size
            aside = obstacle.stiffness * (np.eye(3) - across)
            if length > most:
                along = rub / length
                rub = most * along
                aside = most / length * (aside - obstacle.stiffness * np.outer(along, along))
                aside += obstacle.friction * rise * np.outer(along, normal)
            force, slope = force + rub, slope + aside
        return _Push(force, slope, normal, size > 0.0)

    def _accept(self, offset: Array, force: Array, time: float) -> None:
        """Store the solution of a tick as the start of the next one."""
        self._depth, normal = self._obstacle.depth(offset, time)
        self._force, self._time = force, time
        if self._depth <= 0.0:
            self._stuck_at = None
        elif self._stuck_at is None:
            self._stuck_at = offset
        else:
            # If the tip slides, the surface point follows it, so that the friction stays at its largest value.
            rub = force - float(force @ normal) * normal
            if (spot := self._obstacle.spot(offset)) is not None:
                rub = rub + 0.5 * self._depth**2 * spot.gradient
            self._stuck_at = offset + rub / self._obstacle.stiffness


class _Push(NamedTuple):
    """Force of an obstacle on the tip."""

    force: Array  #: (3,) force [N]
    slope: Array  #: (3, 3) K = -df/dx, where x is the position of the tip [N/m]
    normal: Array  #: (3,) unit normal of the surface
    touches: bool  #: False: the force would be a pull, so there is no contact


def _pushing(force: Array, normal: Array) -> Array:
    """Return a force (3,) of at most `MAX_FORCE_N`; zero for a force that pulls the tip into the obstacle."""
    if not float(force @ normal) > 0.0:
        return np.zeros(3)
    return force * min(1.0, MAX_FORCE_N / float(np.linalg.norm(force)))


_ZERO = np.zeros(3)
