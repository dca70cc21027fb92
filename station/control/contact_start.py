"""Start of the contact of a tip that holds a force, for telemetry."""

from core.control.force_control import CONTACT
from core.control.step import Tick


def contact_start(last: float, now: float, tick: Tick, *, senses: bool = True) -> float:
    """Return the time at which the present contact started [s]; 0 without contact, and without a motion `force`.

    Args:
        last: result of the previous tick [s].
        now: time of this tick [s].
        tick: result of the controller.
        senses: whether the bench has force sensors; otherwise the force from the deflection counts.
    """
    desired, memory = tick.setpoint.press, tick.memory
    if desired is None:
        return 0.0
    force = memory.estimate.force if senses or memory.deflection is None else memory.deflection.force
    touches = -float(desired.direction @ force) > CONTACT * desired.force
    return (last or now) if touches else 0.0
