"""Detection of a load on the robot's shaft, because the controller assumes that every load acts at the tip.

Three times a second the station evaluates the mean of the last half second of telemetry, while the robot moves slowly.
A contact is reported only when consecutive evaluations agree, because one evaluation in a thousand is wrong. A contact
causes only a warning; the operator decides what to do.
"""

from typing import NamedTuple

import numpy as np

from core.calibration.contact import ContactLocation
from core.errors import CtrError
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.control.contact import estimate_contact
from station.control.states import State
from station.control.telemetry import Channels

#: Number of telemetry rows of one evaluation (half a second), and their longest time span if rows are missing [s].
WINDOW_ROWS, MAX_WINDOW_S = 250, 0.6
#: Largest motion of a joint during one evaluation [rad, m], that is 10 deg/s and 10 mm/s.
MAX_JOINT_MOTION = {"rotation": np.deg2rad(5.0), "translation": 5e-3}
#: Largest change of the mean force between fifths of one evaluation [N], because the position of a
#: swinging load would be estimated wrongly.
MAX_FORCE_CHANGE_N = 0.05
#: Smallest force that can be reported as a contact [N]; a smaller one may be drift of the sensors since the tare.
MIN_FORCE_N = 0.1
#: Number of consecutive evaluations that must agree before a contact is reported or withdrawn.
AGREEING_WINDOWS = 3
#: States of the station in which the controller updates its force estimate.
ESTIMATING_STATES = (State.READY, State.RUNNING, State.HOLD, State.STOPPED)


class SideLoad(NamedTuple):
    """A load that acts on the shaft instead of the tip."""

    force: Array  #: mean force (3,), world frame [N]
    contact: ContactLocation

    @property
    def position_text(self) -> str:
        """Position of the load on the shaft with its 95 % interval, as text."""
        first, last = self.contact.intervals[0][0], self.contact.intervals[-1][1]
        return f"{1e3 * self.contact.arc_length:.0f} mm ({1e3 * first:.0f}-{1e3 * last:.0f})"

    @property
    def warning(self) -> str:
        """Warning about the contact, with what the operator should do."""
        where = self.contact.note or f"contact at {self.position_text} from the plate"
        return (
            f"the load does not act at the tip: {where}; check the shaft, and tare the force sensors if nothing"
            " touches it"
        )


class ContactMonitor:
    """Detector of contacts that combines consecutive evaluations; any thread may read `side_load`."""

    def __init__(self, robot: Robot, statics: Statics, channels: Channels) -> None:
        self._statics, self._channels = statics, channels
        self._slow = np.array([MAX_JOINT_MOTION[joint.motion] for joint in robot.joints])
        self._disagreeing = 0  # number of consecutive evaluations that contradict `side_load`
        self.side_load: SideLoad | None = None  #: load on the shaft; None: no load on the shaft is known

    def update(self, rows: Array) -> None:
        """Evaluate the newest `rows` of telemetry (m, channels). Without telemetry `rows` is empty."""
        found = self._evaluate(rows) if self._is_steady(rows) else None
        if len(rows) == 0:
            self._disagreeing, self.side_load = 0, None
        elif (found is None) == (self.side_load is None):
            self._disagreeing, self.side_load = 0, found
        else:
            self._disagreeing += 1
            if self._disagreeing >= AGREEING_WINDOWS:
                self._disagreeing, self.side_load = 0, found

    def _is_steady(self, rows: Array) -> bool:
        """Return whether the rows are complete, no device has a fault, and neither robot nor load moves fast."""
        of = self._channels.of
        return (
            len(rows) >= WINDOW_ROWS
            and 0.0 < of(rows, "time")[-1, 0] - of(rows, "time")[0, 0] < MAX_WINDOW_S
            and bool(np.isin(of(rows, "state"), ESTIMATING_STATES).all())
            and not of(rows, "trouble").any()
            and bool((np.ptp(of(rows, "joints"), axis=0) <= self._slow).all())
            and bool(
                (
                    np.ptp(of(rows[-WINDOW_ROWS:], "force").reshape(5, -1, 3).mean(axis=1), axis=0)
                    <= MAX_FORCE_CHANGE_N
                ).all()
            )
        )

    def _evaluate(self, rows: Array) -> SideLoad | None:
        try:
            estimate = estimate_contact(self._statics, self._channels, rows)
        except CtrError:
            return None  # the model has no shape under this load; the control loop reports the cause
        if estimate is None or estimate.contact is None or float(np.linalg.norm(estimate.force)) < MIN_FORCE_N:
            return None
        return SideLoad(estimate.force, estimate.contact)
