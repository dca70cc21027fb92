"""Stiffness of the tip: the setpoint gives way to the force at the tip.

The loops compensate the natural deflection of the tubes, so alone they make the tip as stiff as the joints allow. With
a desired stiffness K_d, the setpoint moves by K_d^-1 F away from the setpoint of the motion:

    d' = W (K_d^-1 F - d),    |d| <= max_offset,    |d'| <= MAX_SPEED_M_S

Here F is the estimated force on the tip and d the offset of the setpoint. The setpoint's velocity changes by d'. A
wrong force, or a contact that is lost, moves the setpoint by `max_offset` at most, and no faster than `MAX_SPEED_M_S`.

**Stability in contact.** A rigid obstacle turns a joint motion that would move the free tip by x into the force -K_n x,
where K_n is the natural stiffness of the tubes. The eigenvalues r of K_d^-1 K_n state how many times softer than the
tubes the tip shall be. For each eigenvalue, the open loop of force and setpoint follows from the rate w of W, the gain
k of the outer loop and the delay T from a force to the joints:

    L(s) = r w (s + k) / (s (s + w)) exp(-s T)

For k <= w its gain is 1 near the frequency r w, and r w T <= `MAX_CROSSOVER_DELAY` leaves enough phase margin. So both
w and k of each eigenvector are at most `MAX_CROSSOVER_DELAY` / (r T). The tubes are stiffest along their axis; there
the tip returns to its setpoint slowly. A stiffness that would need a gain below `MIN_GAIN_PER_S` is rejected.

**Axes.** The three values of a stiffness are along the axes of the world frame, or along those of the tip. The tip
frame comes from the loaded model: z is the tangent at the tip, and x and y are fixed in the innermost tube. If this
tube is straight and at rotation 0, x and y are those of the front plate. K_d^-1 turns with the tip frame in every tick.

**Changes.** While a motion runs, `StiffnessRamp` changes the compliance linearly within `RAMP_S`. The setpoint then
moves by the force times the change of the compliance, within the bounds above. The largest eigenvalue of K_d^-1 K_n is
a convex function of the compliance, so no stiffness in between is softer than the softer one of the two.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from core.errors import DescriptionError
from core.model.solution import PartsReader
from core.robot.robot import Array, positive

#: Largest product of crossover frequency and delay [rad]: the delay reduces the phase margin by this angle.
MAX_CROSSOVER_DELAY = 0.5
#: Largest rate of the filter [1/s]; a faster filter would pass the noise of the force to the joints.
MAX_RATE_PER_S = 10.0
#: Smallest gain of the outer loop [1/s]: a tip that needs more than 30 s to return would seem to drift.
MIN_GAIN_PER_S = 0.1
#: Time that the stages need to reach a new velocity, in addition to the delays of the line [s].
STAGES_LAG_S = 0.02
#: Largest speed of the offset [m/s], the default bound of streamed setpoints.
MAX_SPEED_M_S = 0.02
#: Time in which the stiffness changes while a motion runs [s]. It is longer than the delays of force and stages.
RAMP_S = 1.0

#: Frame along whose axes a stiffness is given.
StiffnessFrame = Literal["world", "tip"]


class Offset(NamedTuple):
    """Offset of the setpoint that gives way to the force."""

    position: Array  #: (3,) offset from the motion's setpoint [m]
    velocity: Array  #: (3,) velocity of the offset [m/s]


NO_OFFSET = Offset(np.zeros(3), np.zeros(3))


class Rates(NamedTuple):
    """Rates that are stable in contact, in one pose of the robot."""

    filter: Array  #: (3, 3) rate W of the setpoint's offset [1/s]
    gain: Array  #: (3, 3) gain of the outer loop [1/s]


@dataclass(frozen=True)
class TipStiffness:
    """Desired stiffness of the tip."""

    axes: tuple[float, float, float]  #: stiffness along the axes of `frame` [N/m]
    max_offset: float = 0.02  #: largest offset of the setpoint [m]
    frame: StiffnessFrame = "world"

    def __post_init__(self) -> None:
        for axis, value in zip("xyz", self.axes, strict=True):
            positive(f"stiffness along {axis}", value, "N/m")
        positive("max_offset", self.max_offset, "m")

    @cached_property
    def compliance(self) -> Array:
        """Desired compliance along each axis (3,) [m/N]."""
        return 1.0 / np.array(self.axes)

    @cached_property
    def _root(self) -> Array:
        return np.sqrt(self.compliance)

    def softness(self, natural: Array, tip: Array) -> tuple[Array, Array]:
        """Return eigenvalues r (3,), increasing, and eigenvectors of K_d^-1 K_n, made symmetric by the root of K_d^-1.

        `natural` (3, 3) is the compliance of the tubes in this pose, K_n^-1, in the world frame [m/N]. `tip` (3, 3) is
        the frame of the tip. The eigenvectors are in `frame`.
        """
        if self.frame == "tip":
            natural = tip.T @ natural @ tip
        stiffness = np.linalg.inv(0.5 * (natural + natural.T))
        return np.linalg.eigh(self._root[:, None] * stiffness * self._root)

    def rates(self, natural: Array, tip: Array, gain: float, delay: float) -> Rates:
        """Return the rates that are stable in contact.

        Args:
            natural: compliance of the tubes in this pose (3, 3), world frame [m/N].
            tip: frame of the tip (3, 3).
            gain: gain k of the outer loop in free motion [1/s].
            delay: delay T from a force to the joints [s].

        """
        softness, vectors = self.softness(natural, tip)
        rates = MAX_CROSSOVER_DELAY / delay / np.maximum(softness, 1e-9)
        scaled, back = self._root[:, None] * vectors, vectors.T / self._root
        if self.frame == "tip":
            scaled, back = tip @ scaled, back @ tip.T
        return Rates((scaled * np.minimum(rates, MAX_RATE_PER_S)) @ back, (scaled * np.minimum(rates, gain)) @ back)

    def check(self, at: PartsReader, delay: float) -> None:
        """Check that the tip can be controlled in contact with a rigid obstacle, in the pose of the solution `at`.

        Raises:
            DescriptionError: the stiffness is too low; the text has the factor by which it must be increased.

        """
        softness = float(self.softness(at.part("compliance")[:3, :3], at.part("rotation"))[0][-1])
        most = MAX_CROSSOVER_DELAY / (MIN_GAIN_PER_S * delay)
        if softness > most:
            values = ", ".join(f"{value:g}" for value in self.axes)
            raise DescriptionError(
                f"stiffness {values} N/m is {softness:.0f} times softer than the tubes along their stiffest direction;"
                f" the delay of {1e3 * delay:.0f} ms allows {most:.0f} times: multiply the stiffness by"
                f" {softness / most:.2g} or more"
            )

    def update(self, last: Offset, force: Array, tip: Array, rates: Rates, period: float) -> Offset:
        """Return the offset one `period` [s] after `last`.

        `force` (3,) is the estimated force on the tip [N], and `tip` (3, 3) the frame of the tip.
        """
        goal = tip @ (self.compliance * (tip.T @ force)) if self.frame == "tip" else self.compliance * force
        goal = _shortened(goal, self.max_offset)
        velocity = _shortened(rates.filter @ (goal - last.position), MAX_SPEED_M_S)
        position = _shortened(last.position + period * velocity, self.max_offset)
        return Offset(position, (position - last.position) / period)


class StiffnessRamp(NamedTuple):
    """Change from one stiffness to another within `RAMP_S`; both have the same frame."""

    first: TipStiffness
    last: TipStiffness
    start: float  #: time of the start [s]

    def at(self, time: float) -> TipStiffness:
        """Return the stiffness at `time` [s]; its compliance changes linearly."""
        done = (time - self.start) / RAMP_S
        if done >= 1.0:
            return self.last
        compliance = (1.0 - done) * self.first.compliance + done * self.last.compliance
        x, y, z = (1.0 / compliance).tolist()
        return replace(self.last, axes=(x, y, z))


def _shortened(vector: Array, longest: float) -> Array:
    length = float(np.linalg.norm(vector))
    return vector * (longest / length) if length > longest else vector
