"""Whether the load acts at the tip, as the controller takes for granted, and where on the shaft it acts instead.

Looked at three times a second over the last half second of telemetry, while the robot moves slowly enough for
a mean to mean something. What several looks running agree in is believed: a single one errs once in a thousand.
It is a person's to judge; nothing is stopped by it.
"""

from typing import NamedTuple

import numpy as np

from core.calibration.contact import Contact
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.control.contact import look
from station.control.states import State
from station.control.telemetry import Channels

#: Rows of one look, half a second of them, and what they may span when some were missed [s].
ROWS, LONGEST = 250, 0.6
#: What a joint may move in that time: 10 deg/s, 10 mm/s [rad, m].
SLOW = {"rotation": np.deg2rad(5.0), "translation": 5e-3}
#: What the mean force over a fifth of that time may change: a swinging load would seem to act elsewhere [N].
STEADY = 0.05
#: Below this a drift of the sensors since they were zeroed could be all there is [N].
LEAST = 0.1
#: Looks running that must agree before something is said, or not said any more.
AGREED = 3
#: States in which the controller's estimates go on.
STATES = (State.READY, State.RUNNING, State.HOLD, State.STOPPED)


class SideLoad(NamedTuple):
    """A load that does not act at the tip."""

    force: Array  #: (3,) mean, world frame [N]
    contact: Contact

    @property
    def place(self) -> str:
        """Where, for a person, with 95 %."""
        first, last = self.contact.intervals[0][0], self.contact.intervals[-1][1]
        return f"{1e3 * self.contact.place:.0f} mm ({1e3 * first:.0f}-{1e3 * last:.0f})"

    @property
    def warning(self) -> str:
        """For a person, with what can be done."""
        where = self.contact.note or f"contact at {self.place} from the plate"
        return (
            f"the load does not act at the tip: {where}; look at the shaft, and zero the force sensors if nothing"
            " touches it"
        )


class ContactMonitor:
    """Remembers what the last looks said; `side_load` may be read by any thread."""

    def __init__(self, robot: Robot, statics: Statics, channels: Channels) -> None:
        self._statics, self._channels = statics, channels
        self._slow = np.array([SLOW[joint.motion] for joint in robot.joints])
        self._looks = 0  # running, that say something else than `side_load` does
        self.side_load: SideLoad | None = (
            None  #: the load beside the tip; None: there is none, or it cannot be told now
        )

    def look(self, rows: Array) -> None:
        """Look at the newest rows (m, channels) of a station; none when it is silent."""
        found = self._look(rows) if self._can_tell(rows) else None
        if len(rows) == 0:
            self._looks, self.side_load = 0, None
        elif (found is None) == (self.side_load is None):
            self._looks, self.side_load = 0, found
        else:
            self._looks += 1
            if self._looks >= AGREED:
                self._looks, self.side_load = 0, found

    def _can_tell(self, rows: Array) -> bool:
        """Whether the robot is under control, everything is measured, and neither it nor its load moves fast."""
        of = self._channels.of
        return (
            len(rows) >= ROWS
            and 0.0 < of(rows, "time")[-1, 0] - of(rows, "time")[0, 0] < LONGEST
            and bool(np.isin(of(rows, "state"), STATES).all())
            and not of(rows, "trouble").any()
            and bool((np.ptp(of(rows, "joints"), axis=0) <= self._slow).all())
            and bool((np.ptp(of(rows[-ROWS:], "force").reshape(5, -1, 3).mean(axis=1), axis=0) <= STEADY).all())
        )

    def _look(self, rows: Array) -> SideLoad | None:
        try:
            touch = look(self._statics, self._channels, rows)
        except CtrError:
            return None  # no shape under this load: what is wrong then is the control loop's to say
        if touch is None or touch.contact is None or float(np.linalg.norm(touch.force)) < LEAST:
            return None
        return SideLoad(touch.force, touch.contact)
