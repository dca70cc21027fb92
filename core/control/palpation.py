"""Palpation: the tip visits places in front of an obstacle and presses on each with two forces, one after the other.

The stiffness of a place is the difference of the two forces over the travel of the tip between them. A constant error
of the force or of the tip's position cancels in these differences. Force and position are averaged over the second half
of the time for a force, when the force has settled.

The desired force changes from one force to the other along a ramp. After a jump, the joints would be at their speed
limits, and the tip would slide across the direction of the press.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from core.control.force_control import Press
from core.control.trajectories import Setpoint
from core.robot.robot import Array, positive

#: Fractions of the time between two places: the force falls to the smaller force, then the tip retreats. In the
#: remaining time the tip moves to the next place.
UNLOADING_SHARE, RETREAT_SHARE = 0.25, 0.2
#: Fraction of the time for the greater force in which the force rises to it.
LOADING_SHARE = 0.3
#: Fraction of the time for a force after which averaging starts.
SETTLING_SHARE = 0.5
#: Largest deviation of a measured mean force from the desired force, as a fraction; beyond it there is no estimate,
#: because the tip has not found the obstacle or the force has not settled.
MAX_DEVIATION = 0.5
#: Smallest travel of the tip between the two forces for an estimate [m]: five times the error of a measured travel.
MIN_TRAVEL_M = 1e-4


@dataclass(frozen=True)
class Palpation:
    """Trajectory that visits places near the start tip and presses on each with two forces, one after the other."""

    places: tuple[tuple[float, float, float], ...]  #: offsets from the start tip in the order of the visits [m]
    light: Press  #: first, smaller force at each place
    firm: Press  #: second force at each place, in the same direction
    travel: float  #: time of the retreat and of the motion to the next place [s]
    dwell: float  #: time for each of the two forces; the first includes the approach [s]

    def __post_init__(self) -> None:
        positive("palpation: travel", self.travel, "s")
        positive("palpation: dwell", self.dwell, "s")

    @property
    def visit(self) -> float:
        """Duration of the visit of one place [s]."""
        return self.travel + 2.0 * self.dwell

    @property
    def period(self) -> float:
        """Time until the tip is in front of the last place again [s]."""
        return len(self.places) * self.visit

    @cached_property
    def _stops(self) -> Array:
        return np.array(((0.0, 0.0, 0.0), *self.places))

    def setpoint(self, time: float) -> Setpoint:
        """Return the desired offset, velocity and force at `time` [s] from the start."""
        time = max(time, 0.0)
        number = math.floor(time / self.visit)
        since, done = time - number * self.visit, number >= len(self.places)
        before, after = self._stops[min(number, len(self.places))], self._stops[min(number + 1, len(self.places))]
        force = self._force(number, since)
        if force is not None:
            place = before if since < self.travel else after
            return Setpoint(place.copy(), np.zeros(3), press=self.light._replace(force=force))
        start = (UNLOADING_SHARE + RETREAT_SHARE) * self.travel
        phase = 0.0 if done else math.pi * max(since - start, 0.0) / (self.travel - start)
        part, rate = 0.5 * (1.0 - math.cos(phase)), 0.5 * math.pi * math.sin(phase) / (self.travel - start)
        return Setpoint(before + part * (after - before), rate * (after - before))

    def _force(self, number: int, since: float) -> float | None:
        """Return the desired force [N] at `since` [s] after the start of visit `number`; None while not pressing."""
        light, rise = self.light.force, self.firm.force - self.light.force
        unloading = UNLOADING_SHARE * self.travel
        if since < unloading and 1 <= number <= len(self.places):
            return light + rise * (1.0 - since / unloading)
        if since < self.travel or number >= len(self.places):
            return None
        loading = max(since - self.travel - self.dwell, 0.0) / (LOADING_SHARE * self.dwell)
        return light + rise * min(loading, 1.0)

    def desired_force(self, times: Array) -> Array:
        """Return the desired force [N] at `times` (m,) [s] from the start; NaN while the tip does not press."""
        presses = (self.setpoint(time).press for time in times.tolist())
        return np.array([np.nan if press is None else press.force for press in presses])

    def measured(self, times: Array) -> NDArray[np.bool_]:
        """Return whether each of `times` (m,) [s] is in the second half of the time for a force."""
        number, since = np.divmod(times, self.visit)
        settled = np.mod(since - self.travel, self.dwell) >= SETTLING_SHARE * self.dwell
        return settled & (since >= self.travel) & (times >= 0.0) & (number < len(self.places))

    def stiffness(self, times: Array, force: Array, frame_times: Array, tip: Array) -> Array:
        """Return the estimated stiffness of each place (places,) [N/m]; NaN for a place without an estimate.

        Args:
            times: times of the force (m,) [s] from the start.
            force: measured force of the tip on the obstacle along the direction (m,) [N].
            frame_times: times at which the tip was measured (f,) [s] from the start.
            tip: measured position of the tip along the direction (f,) [m].
        """
        desired = np.array((self.light.force, self.firm.force))
        forces, tips = self._means(times, force), self._means(frame_times, tip)
        held = (np.abs(forces - desired) <= MAX_DEVIATION * desired).all(axis=1)
        travel = tips[:, 1] - tips[:, 0]
        known = held & (travel >= MIN_TRAVEL_M)
        return np.where(known, (forces[:, 1] - forces[:, 0]) / np.where(known, travel, 1.0), np.nan)

    def _means(self, times: Array, values: Array) -> Array:
        """Return the means of `values` (m,) for each place and each of its forces (places, 2); NaN without values."""
        used = self.measured(times)
        number, since = np.divmod(times[used], self.visit)
        press = 2 * number.astype(int) + (since >= self.travel + self.dwell)
        count = np.bincount(press, minlength=2 * len(self.places))
        total = np.bincount(press, values[used], minlength=2 * len(self.places))
        return np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(-1, 2)
