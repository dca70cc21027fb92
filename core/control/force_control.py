"""Force control of the tip along a direction: the tip approaches until contact, and then keeps a force.

Along the direction n of a `Press` the tip's position is not controlled. The joints alone move the tip with the velocity

    v = a g c (F - f) + s - (1 - a) h c f',    s' = RESET b (a g)^2 c (F - f),    c = n' C n

Here F is the desired force, f the filtered force that the tip exerts along n and C the compliance of the tubes. If the
obstacle moves, the integral s approaches its speed. Across n the loops control the position as in every motion.

**Stability.** On a rigid obstacle, joints that would move the free tip by dx raise the force by dx / c. The loop gain
is therefore 1 at the frequency g. The delay from a force to the joints is T; g T = `CROSSOVER_DELAY` leaves enough
phase margin. A soft obstacle gives way, so the crossover frequency is lower. While the loops control the position
across n, the tip is stiffer by the ratio r = c n' C^-1 n, which is largest along the axis of a curved robot. The phase
margin allows for that. The integral uses a part of this margin. The factor b = min(1, `STIFFER` / r) makes the integral
slower along the axis, where friction in the tubes would sustain an oscillation with a fast integral.

**Approach.** The force rises at most by v T / c before the joints respond to the contact. So the approach is not faster
than `OVERSHOOT` F c / T, and the force exceeds F by at most `OVERSHOOT` F. Without contact s is zero.

**Fast obstacles.** The joints have a largest speed and a largest acceleration A along n. A joint that must reverse too
fast lags, and would then push when it should retreat. The law needs the acceleration a g c R, where R is the root of
twice the recent mean square of f'. The factor a <= 1 keeps this acceleration within A. Where a is below 1, the damping
h = `DAMPING` moves the tip in phase with the obstacle instead.
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
#: Time constant of the force's filter, as a fraction of the delay. The serial line takes a command every 25 ms; without
#: the filter, each command would contain the noise of a single sample.
FILTER = 0.25
#: Time constant of the filter of the force's rate, as a fraction of the delay.
RATE_FILTER = 1.0
#: Time constant of the mean square of the force's rate [s].
MEMORY_S = 1.0
#: Largest assumed speed of an obstacle, in multiples of the tip's largest speed: limits the effect of a wrong force.
QUICKEST = 4.0
#: Gain of the force's rate for an obstacle that is too fast for the joints.
DAMPING = 0.6
#: Fraction of the joints' top speed and acceleration for the motion along the direction; the rest is for the motion
#: across it.
SHARE = 0.9


class Press(NamedTuple):
    """Desired force of the tip along a direction, and the bounds of the motion along it."""

    direction: Array  #: (3,) unit vector in which the tip presses, world frame
    force: float  #: desired force of the tip on the obstacle [N]
    speed: float  #: largest speed of the approach to the first contact [m/s]
    reach: float  #: largest distance from the start of the motion, in both directions along `direction` [m]


class Contact(NamedTuple):
    """State of a press."""

    found: bool  #: whether the tip has had contact
    speed: float  #: the integral s: speed of the obstacle along the direction [m/s]
    velocity: float  #: tip velocity v that the joints shall cause [m/s]
    force: float  #: filtered force f of the tip along the direction [N]
    rate: float  #: filtered rate f' of the force [N/s]
    rate_square: float  #: recent mean square of f' [N^2/s^2]


#: State before the first contact.
NO_CONTACT = Contact(False, 0.0, 0.0, 0.0, 0.0, 0.0)


class Agility(NamedTuple):
    """Largest speed and acceleration of the tip along the direction of a press, without motion across it."""

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
    joints = speeds * np.linalg.lstsq(jacobian * speeds, direction, rcond=None)[0]  # they move the tip at 1 m/s
    return Agility(*(SHARE / max(float(np.abs(joints / most).max()), 1e-9) for most in (speeds, accelerations)))


def press(
    desired: Press, last: Contact, force: Array, compliance: Array, travel: float, joints: Agility, gain: float,
    delay: float, period: float,
) -> Contact:  # fmt: skip
    """Return the state of a press one period after `last`, with the tip velocity that the joints shall cause.

    Args:
        desired: desired force.
        last: state one period before.
        force: estimated force on the tip (3,) [N].
        compliance: compliance of the tubes (3, 3) [m/N].
        travel: distance of the tip from the start of the motion along the direction [m].
        joints: largest speed and acceleration of the tip along the direction.
        gain: gain of the outer loop; with it, the tip slows down near the end of the reach [1/s].
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
    """Return a vector (3,) whose component along a unit vector (3,) is replaced by `component`."""
    return without_component(vector, direction) + component * np.asarray(direction)
