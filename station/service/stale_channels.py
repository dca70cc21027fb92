"""Find the stale values in a row of telemetry.

A row always has every channel. It repeats the last known values while stages are being homed, lost or reconnected, and
while a device has no valid sample.
"""

from core.robot.robot import Array
from station.control.telemetry import Channels
from station.devices.interfaces import Severity

TRACKER_CHANNELS = frozenset({"tip_measured", "tip_time", "direction_measured", "target_measured"})
SENSOR_CHANNELS = frozenset({
    "force", "force_filtered", "force_estimated", "force_variance", "force_covariance", "moment", "moment_mismatch",
    "deflection", "deflection_filtered", "deflection_rate",
})  # fmt: skip
TRUTH_CHANNELS = frozenset({"tip_true", "force_true", "direction_true", "target_true"})
#: Channels that each tick of the controller updates.
COMPUTED_CHANNELS = TRACKER_CHANNELS | SENSOR_CHANNELS | TRUTH_CHANNELS | {
    "tip_estimated", "tip_desired", "direction_observed", "direction_desired", "u_int", "target_offset",
}  # fmt: skip
#: Channels of unit vectors; they are 0 if the tip's direction is neither measured nor controlled.
DIRECTION_CHANNELS = ("direction_measured", "direction_observed", "direction_desired", "direction_true")


def stale_groups(channels: Channels, row: Array) -> frozenset[str]:
    """Return the groups of channels whose values in a row are stale or were never known."""
    if channels.of(row, "estimates_frozen")[0]:
        return COMPUTED_CHANNELS
    _, tracker, sensors = channels.of(row, "trouble")
    unknown = (
        (TRACKER_CHANNELS, tracker >= Severity.HOLD),
        (SENSOR_CHANNELS, sensors >= Severity.HOLD),
        (TRUTH_CHANNELS, not channels.of(row, "truth_known")[0]),
    )
    nowhere = (group for group in DIRECTION_CHANNELS if not channels.of(row, group).any())
    return frozenset(nowhere).union(*(groups for groups, old in unknown if old))
