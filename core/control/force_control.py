"""Force of the tip along a direction: the tip approaches until contact, and then holds a force.

Along the direction n of a `Press` the tip's position is not controlled. The joints alone move the tip with the velocity

    v = g c (F - f) + s,    s' = RESET g^2 c (F - f),    c = n' C n

Here F is the desired force, f the estimated force that the tip exerts along n and C the compliance of the tubes. The
integral s becomes the speed of an obstacle that moves. Across n the loops control the position as in every other
motion.

**Stability.** On a rigid obstacle a motion of the free tip by dx raises the force by dx / c, so the loop crosses 1 at
g. It has the delay T from a force to the joints, and g T = `CROSSOVER_DELAY` leaves enough phase margin. A soft
obstacle gives way, so the loop crosses 1 at a lower frequency. In a curved robot the tip is stiffer along its axis than
1 / c while the loops hold it across n; the phase margin allows for that.

**Approach.** The force rises at most by v T / c before the joints respond to the contact. So the approach is not faster
than `OVERSHOOT` F c / T, and the force exceeds F by at most `OVERSHOOT` F. Without contact s is zero.
"""

from typing import NamedTuple

import numpy as np

from core.robot.robot import Array

#: Product of the crossover frequency and the delay [rad].
CROSSOVER_DELAY = 0.35
#: Rate of the integral, as a fraction of g.
RESET = 0.2
#: Largest excess of the force at the contact, as a fraction of the desired force.
OVERSHOOT = 0.5
#: Fraction of the desired force below which the tip has no contact.
CONTACT = 0.1
#: Largest speed with which the tip follows an obstacle or retreats from it [m/s].
MAX_SPEED_M_S = 0.05


class Press(NamedTuple):
    """Force that the tip shall exert along a direction."""

    direction: Array  #: (3,) unit vector in which the tip presses, world frame
    force: float  #: desired force of the tip on the obstacle [N]
    speed: float  #: largest speed of the approach to the first contact [m/s]
    reach: float  #: largest distance from the start of the motion, in both directions along `direction` [m]


class Contact(NamedTuple):
    """State of a press."""

    found: bool  #: whether the tip has had contact
    speed: float  #: the integral s: speed of the obstacle along the direction [m/s]
    velocity: float  #: velocity v of the tip by the joints [m/s]


#: State before the first contact.
NO_CONTACT = Contact(False, 0.0, 0.0)


def press(
    desired: Press, last: Contact, force: Array, compliance: Array, travel: float, gain: float, delay: float,
    period: float,
) -> Contact:  # fmt: skip
    """Return the state of a press one period after `last`, with the velocity for the joints.

    Args:
        desired: desired force.
        last: state one period before.
        force: estimated force on the tip (3,) [N].
        compliance: compliance of the tubes (3, 3) [m/N].
        travel: distance of the tip from the start of the motion along the direction [m].
        gain: gain of the outer loop, with which the tip slows down in front of the end of the reach [1/s].
        delay: delay T from a force to the joints [s].
        period: time between two ticks [s].
    """
    along = desired.direction
    softness, exerted = float(along @ compliance @ along), -float(along @ force)
    touches, crossover = exerted > CONTACT * desired.force, CROSSOVER_DELAY / delay
    found = last.found or touches
    by_force = crossover * softness * (desired.force - exerted)
    highest = min(MAX_SPEED_M_S, OVERSHOOT * desired.force * softness / delay)
    if not found:
        highest = min(highest, desired.speed)
    speed = _within(last.speed + period * RESET * crossover * by_force, MAX_SPEED_M_S) if touches else 0.0
    velocity = min(max(by_force + speed, -MAX_SPEED_M_S), highest)
    velocity = min(max(velocity, gain * (-desired.reach - travel)), gain * (desired.reach - travel))
    return Contact(found, speed, velocity)


def _within(value: float, largest: float) -> float:
    return min(max(value, -largest), largest)


def without_component(vector: Array, direction: Array) -> Array:
    """Return a vector (3,) without its component along a unit vector (3,)."""
    return vector - float(direction @ vector) * direction


def replaced_component(vector: Array, direction: Array, component: float) -> Array:
    """Return a vector (3,) with another component along a unit vector (3,)."""
    return without_component(vector, direction) + component * np.asarray(direction)
