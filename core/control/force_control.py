"""Force of the tip along a direction: the tip approaches until contact, and then holds a force.

Along the direction n of a `Press` the tip's position is not controlled. The joints alone move the tip with the velocity

    v = a g c (F - f) + s - (1 - a) h c f',    s' = RESET b (a g)^2 c (F - f),    c = n' C n

Here F is the desired force, f the filtered force that the tip exerts along n and C the compliance of the tubes. The
integral s becomes the speed of an obstacle that moves. Across n the loops control the position as in every other
motion.

**Stability.** On a rigid obstacle a motion of the free tip by dx raises the force by dx / c, so the loop crosses 1 at
g. It has the delay T from a force to the joints, and g T = `CROSSOVER_DELAY` leaves enough phase margin. A soft
obstacle gives way, so the loop crosses 1 at a lower frequency. While the loops hold the tip across n, it is stiffer by
the ratio r = c n' C^-1 n, which is largest along the axis of a curved robot. The phase margin allows for that. The
integral takes a part of this margin, so b = min(1, `STIFFER` / r) makes it slower along the axis. There, with a quick
integral, friction in the tubes keeps up an oscillation.

**Approach.** The force rises at most by v T / c before the joints respond to the contact. So the approach is not faster
than `OVERSHOOT` F c / T, and the force exceeds F by at most `OVERSHOOT` F. Without contact s is zero.

**Quick obstacles.** The joints have a largest speed and a largest acceleration A along n. A joint that must turn
around too quickly lags, and would then push when it should retreat. With R, the root of twice the recent mean square of
f', the law needs the acceleration a g c R. The factor a <= 1 keeps it within A. As far as a is below 1, the damping h =
`DAMPING` moves the tip with the obstacle instead, in phase.
"""

import math
from typing import NamedTuple

import numpy as np

from core.robot.robot import Array

#: Product of the crossover frequency and the delay [rad].
CROSSOVER_DELAY = 0.45
#: Rate of the integral, as a fraction of the crossover frequency.
RESET = 0.4
#: Ratio r above which the integral is slower: the paper's robot has 8 across its axis, and 23 along it.
STIFFER = 12.0
#: Largest excess of the force at the contact, as a fraction of the desired force.
OVERSHOOT = 0.5
#: Fraction of the desired force below which the tip has no contact.
CONTACT = 0.1
#: Time constant of the force's filter, as a fraction of the delay. Without the filter, commands that the line takes
#: every 25 ms would contain the noise of single samples.
FILTER = 0.25
#: Time constant of the filter of the force's rate, as a fraction of the delay.
RATE_FILTER = 1.0
#: Time constant of the mean square of the force's rate [s].
MEMORY_S = 1.0
#: Largest used speed of an obstacle, as a multiple of the joints' largest speed: bounds the memory of a wrong force.
QUICKEST = 4.0
#: Gain of the force's rate for an obstacle that is too quick for the joints.
DAMPING = 0.6
#: Fraction of the joints' top speed and acceleration for the motion along the direction; the rest is for the motion
#: across it.
SHARE = 0.9


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
    force: float  #: filtered force f of the tip along the direction [N]
    rate: float  #: filtered rate f' of the force [N/s]
    rate_square: float  #: recent mean square of f' [N^2/s^2]


#: State before the first contact.
NO_CONTACT = Contact(False, 0.0, 0.0, 0.0, 0.0, 0.0)


class Agility(NamedTuple):
    """What the joints can do along the direction of a press without motion across it."""

    speed: float  #: largest speed of the tip [m/s]
    acceleration: float  #: largest acceleration of the tip [m/s^2]


def agility(jacobian: Array, speeds: Array, accelerations: Array, direction: Array) -> Agility:
    """Return the tip's largest speed and acceleration along a unit vector `direction` (3,).

    Args:
        jacobian: derivative of the tip by the joints (3, n) [m/rad or m/m].
        speeds: top speeds of the joints (n,) [rad/s or m/s].
        accelerations: largest accelerations of the joints (n,) [rad/s^2 or m/s^2].
        direction: unit vector (3,).

    """
    joints = speeds * np.linalg.lstsq(jacobian * speeds, direction, rcond=None)[0]  # for a tip at 1 m/s
    return Agility(*(SHARE / max(float(np.abs(joints / most).max()), 1e-9) for most in (speeds, accelerations)))


def press(
    desired: Press, last: Contact, force: Array, compliance: Array, travel: float, joints: Agility, gain: float,
    delay: float, period: float,
) -> Contact:  # fmt: skip
    """Return the state of a press one period after `last`, with the velocity for the joints.

    Args:
        desired: desired force.
        last: state one period before.
        force: estimated force on the tip (3,) [N].
        compliance: compliance of the tubes (3, 3) [m/N].
        travel: distance of the tip from the start of the motion along the direction [m].
        joints: largest speed and acceleration of the tip along the direction.
        gain: gain of the outer loop, with which the tip slows down in front of the end of the reach [1/s].
        delay: delay T from a force to the joints [s].
        period: time between two ticks [s].
    """
    along = desired.direction
    softness = float(along @ compliance @ along)
    ratio = softness * float(along @ np.linalg.solve(compliance, along))
    reset = RESET * min(1.0, STIFFER / ratio) if ratio > 0.0 else RESET
    exerted = last.force + period / (FILTER * delay + period) * (-float(along @ force) - last.force)
    rate = last.rate + period / (RATE_FILTER * delay + period) * ((exerted - last.force) / period - last.rate)
    rate = _within(rate, QUICKEST * joints.speed / softness)
    square = last.rate_square + period / MEMORY_S * (rate * rate - last.rate_square)
    touches, crossover = exerted > CONTACT * desired.force, CROSSOVER_DELAY / delay
    found = last.found or touches
    needed = crossover * softness * math.sqrt(2.0 * square)
    share = min(1.0, joints.acceleration / max(needed, 1e-9))
    crossover *= share
    by_force = crossover * softness * (desired.force - exerted)
    damping = (1.0 - share) * DAMPING * softness * rate if touches else 0.0
    speed = _within(last.speed + period * reset * crossover * by_force, joints.speed) if touches else 0.0
    highest = min(joints.speed, OVERSHOOT * desired.force * softness / delay)
    if not found:
        highest = min(highest, desired.speed)
    velocity = min(max(by_force + speed - damping, -joints.speed), highest)
    velocity = min(max(velocity, gain * (-desired.reach - travel)), gain * (desired.reach - travel))
    return Contact(found, speed, velocity, exerted, rate, square)


def _within(value: float, largest: float) -> float:
    return min(max(value, -largest), largest)


def without_component(vector: Array, direction: Array) -> Array:
    """Return a vector (3,) without its component along a unit vector (3,)."""
    return vector - float(direction @ vector) * direction


def replaced_component(vector: Array, direction: Array, component: float) -> Array:
    """Return a vector (3,) with another component along a unit vector (3,)."""
    return without_component(vector, direction) + component * np.asarray(direction)
