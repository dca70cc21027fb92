"""Which of the newest telemetry is measured now: a row goes on although a device in it stands still."""

from typing import NamedTuple

import numpy as np

from station.control.states import State
from station.devices.interfaces import Severity
from station.service.status import STALE, Status
from web.scene.history import History

#: States in which the stages know where they are, so that forces can be told from the sensors.
KNOWN = (State.READY, State.RUNNING, State.HOLD, State.STOPPED, State.FAULT)
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
    stages, _, sensors = (severity < Severity.HOLD for severity in status.values["trouble"])
    return Fresh(
        row=True,
        joints=bool(stages),
        tip=history.now - history.measured <= TIP_AGE,
        force=bool(sensors) and status.state in KNOWN and not _stands(history),
    )


def _stands(history: History) -> bool:
    """Whether the estimate of the force stands still under sensors that go on: nothing carries it on."""
    return bool(np.ptp(history.group("force"), axis=0).max() == 0.0 < np.ptp(history.group("wrench_raw"), axis=0).max())
