"""Validity of the newest telemetry row: a row has all channels, but the values of a silent device are stale."""

from typing import NamedTuple

from station.devices.interfaces import Severity
from station.service.status import STALE_AFTER_S, StationStatus
from web.scene.history import TipTrace

#: Age from which a measured tip is stale [s]; the control loop has the same timeout for the tracker.
MAX_TIP_AGE_S = 0.25


class Validity(NamedTuple):
    """Which values of the newest telemetry row are current."""

    row: bool  #: whether the control loop writes telemetry
    joints: bool  #: whether the stages answer
    tip: bool  #: whether the tracker measures the tip
    force: bool  #: whether the force sensors measure and the force estimate is updated

    @property
    def message(self) -> str:
        """Text that lists the stale values; empty if all are current."""
        parts = {"joints": self.joints, "tip": self.tip, "force": self.force}
        missing = [name for name, known in parts.items() if not known]
        return f"not measured now: {', '.join(missing)}" if missing else ""


NOTHING = Validity(row=False, joints=False, tip=False, force=False)


def validity_of(status: StationStatus, history: TipTrace) -> Validity:
    """Return the validity of the newest telemetry row."""
    if not status.values or status.age > STALE_AFTER_S or len(history.recent) == 0:
        return NOTHING
    return Validity(
        row=True,
        joints=bool(status.values["trouble"][0] < Severity.HOLD),
        tip=history.now - history.measured <= MAX_TIP_AGE_S,  # not every row has a new frame
        force="force" not in status.stale_groups,
    )
