"""Which values of a row are of now, and which only stand there since somebody last renewed them.

A row has every channel: while stages are homed, lost or connected anew, and while a device has nothing fit for
control, what was known last is repeated.
"""

from core.robot.robot import Array
from station.control.telemetry import Channels
from station.devices.interfaces import Severity

TRACKED = frozenset({"tip_measured", "tip_time", "direction_measured", "target_measured"})
FELT = frozenset({"force", "force_filtered", "moment", "deflection", "deflection_filtered", "deflection_rate"})
TRUE = frozenset({"tip_true", "force_true", "direction_true", "target_true"})
#: What a tick of the controller renews, and what is written down with it.
COMPUTED = TRACKED | FELT | TRUE | {
    "tip_estimated", "tip_desired", "direction_observed", "direction_desired", "u_int", "target_offset",
}  # fmt: skip
#: Unit vectors; 0 where nobody asks where the tip points.
DIRECTIONS = ("direction_measured", "direction_observed", "direction_desired", "direction_true")


def standing(channels: Channels, row: Array) -> frozenset[str]:
    """Groups of a row that are old, or were never known."""
    if channels.of(row, "held")[0]:
        return COMPUTED
    _, tracker, sensors = channels.of(row, "trouble")
    unknown = (
        (TRACKED, tracker >= Severity.HOLD),
        (FELT, sensors >= Severity.HOLD),
        (TRUE, not channels.of(row, "truth_known")[0]),
    )
    nowhere = (group for group in DIRECTIONS if not channels.of(row, group).any())
    return frozenset(nowhere).union(*(groups for groups, old in unknown if old))
