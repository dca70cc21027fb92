"""Start of the contact of a tip that holds a force, for telemetry."""

from core.control.force_control import CONTACT, Press
from core.control.step import Tick


def contact_start(last: float, now: float, desired: Press, tick: Tick) -> float:
    """Return the time at which the present contact of a tip that presses started [s]; 0 without contact.

    Args:
        last: result of the previous tick [s].
        now: time of this tick [s].
        desired: desired force of the tip.
        tick: result of the controller.
    """
    touches = tick.memory.contact.force > CONTACT * desired.force
    return (last or now) if touches else 0.0
