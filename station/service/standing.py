"""Which values of the newest row are of now, and which only stand there since somebody last renewed them.

A row has every channel: while stages are homed, lost or connected anew, and while a device has nothing fit for
control, what was known last is repeated.
"""

from core.robot.robot import Array
from station.devices.interfaces import Severity

TRACKED = frozenset({"tip_measured", "tip_time"})
FELT = frozenset({"force", "moment", "deflection", "deflection_rate"})
#: What a tick of the controller renews, and what is written down with it.
COMPUTED = TRACKED | FELT | {"tip_estimated", "tip_desired", "tip_true", "u_int"}


def standing(troubles: Array, held: bool) -> frozenset[str]:
    """Groups of telemetry that are old.

    Args:
        troubles: severities of what is wrong with stages, tracker and force sensors (3,), of the row.
        held: the controller has not renewed the row.
    """
    if held:
        return COMPUTED
    _, tracker, sensors = troubles
    return (TRACKED if tracker >= Severity.HOLD else frozenset()) | (FELT if sensors >= Severity.HOLD else frozenset())
