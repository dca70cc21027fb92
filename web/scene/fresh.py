"""Which of the newest telemetry is measured now: a row goes on although a device in it stands still."""

from typing import NamedTuple

from station.devices.interfaces import Severity
from station.service.status import STALE, Status
from web.scene.history import History

#: A tip that was measured longer ago is an old one: so long the loop itself waits for the tracker [s].
TIP_AGE = 0.25


class Fresh(NamedTuple):
    """What may be drawn as it is."""

    row: bool  #: telemetry comes: time and joints are those of now
    joints: bool  #: the stages answer
    tip: bool  #: the tracker measures
    force: bool  #: the sensors measure and the estimate follows them

    @property
    def says(self) -> str:
        """What is not, for a person; empty when everything is."""
        parts = {"joints": self.joints, "tip": self.tip, "force": self.force}
        missing = [name for name, known in parts.items() if not known]
        return f"not measured now: {', '.join(missing)}" if missing else ""


NOTHING = Fresh(row=False, joints=False, tip=False, force=False)


def fresh(status: Status, history: History) -> Fresh:
    """What the newest row tells of now."""
    if not status.values or status.age > STALE or len(history.recent) == 0:
        return NOTHING
    return Fresh(
        row=True,
        joints=bool(status.values["trouble"][0] < Severity.HOLD),
        tip=history.now - history.measured <= TIP_AGE,  # a tracker has a frame for some of the rows only
        force="force" not in status.standing,
    )
