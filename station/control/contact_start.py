"""Start of the contact of a tip that holds a force, for telemetry."""

from core.control.force_control import CONTACT
from core.control.step import Tick


def contact_start(last: float, now: float, tick: Tick) -> float:
    """Return the time at which the present contact started [s]; 0 without contact, and while the tip does not press.

    Args:
        last: result of the previous tick [s].
        now: time of this tick [s].
        tick: result of the controller.
    """
    desired = tick.setpoint.press
    touches = desired is not None and tick.memory.contact.force > CONTACT * desired.force
    return (last or now) if touches else 0.0
