"""Detection of a load on the robot's shaft, because the controller assumes that every load acts at the tip.

For a load at the tip, the measured force determines the moment at the base sensors. A different measured moment shows
that the load acts elsewhere. Single samples are too noisy for this test; half a second of samples is enough. A contact
is reported only when consecutive evaluations agree, because one evaluation in a thousand is wrong. It causes only a
warning; the operator decides what to do. One estimate takes about ten milliseconds, so the control loop does not
compute it.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.calibration.contact import (
    MIN_FORCE_N,
    ContactLocation,
    TipLoad,
    contact_spans,
    evaluate_tip_load,
    locate_contact,
)
from core.calibration.measurements import Noise
from core.control.sensors import FusedLoad
from core.errors import CtrError
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.robot import Array, Robot
from station.control.states import State
from station.control.telemetry import Channels

#: Error of force and moment that averaging does not reduce: drift since the tare, mounting, quantisation [N, N m].
NOISE_FLOOR = Noise(force=5e-3, moment=0.2e-3)
#: 99 % quantile of the chi-square distribution with two degrees of freedom. If the chi square of the
#: best contact is larger, the noise is larger than assumed.
CHI_SQUARE_99_TWO_DOF = 9.21
NO_SINGLE_CONTACT = "the moments fit no single contact well: there are two contacts, or drift (tare again without load)"
#: Smallest number of telemetry rows from which the noise can be estimated.
MIN_ROWS = 20


class ContactReport(NamedTuple):
    """Load that the base sensors measure, and where it acts."""

    force: Array  #: (3,) mean force [N]
    tip: TipLoad  #: whether the load acts at the tip
    #: contact that explains the load; None if a load at the tip explains it, or the force is too small
    contact: ContactLocation | None


def estimate_contact(statics: Statics, channels: Channels, rows: Array) -> ContactReport | None:
    """Return load and contact from half a second of telemetry (m, channels) of a slow motion; None: too few rows.

    Raises:
        CtrError: the model has no shape under this load.
    """
    if len(rows) < MIN_ROWS:
        return None
    joints = channels.of(rows, "joints").mean(axis=0)
    forces, moments = channels.of(rows, "force"), channels.of(rows, "moment")
    # The moments are about the plate, so they contain noise of the forces at the proximal ends of the tubes.
    noise = Noise(force=_error(forces, NOISE_FLOOR.force), moment=_error(moments, NOISE_FLOOR.moment))
    load = FusedLoad(forces.mean(axis=0), moments.mean(axis=0))
    # Test with the model's tip and with the tracker's tip: an error of either tip must not appear as a contact.
    modelled = statics.solve(joints, pure_force(load.force)).tip
    tips = modelled, channels.of(rows, "tip_measured").mean(axis=0)
    touch = _explain(statics, joints, load, tips, noise)
    if touch.contact is not None and touch.contact.statistic > CHI_SQUARE_99_TWO_DOF:
        # The noise is larger than assumed, for example by drift since the tare: repeat with larger noise.
        more = math.sqrt(touch.contact.statistic / 2.0)
        touch = _explain(statics, joints, load, tips, Noise(force=more * noise.force, moment=more * noise.moment))
        contact = touch.contact
        if contact is not None and not contact.located:
            touch = touch._replace(
                contact=contact._replace(note=f"{NO_SINGLE_CONTACT}: {contact_spans(contact.intervals)}")
            )
    return touch


def _explain(statics: Statics, joints: Array, load: FusedLoad, tips: Sequence[Array], noise: Noise) -> ContactReport:
    """Return the load with its explanation: a load at the tip if possible, otherwise a contact on the shaft."""
    at_tip = min((evaluate_tip_load(load, tip, noise) for tip in tips), key=lambda tested: tested.statistic)
    if at_tip.accepted or float(np.linalg.norm(load.force)) < MIN_FORCE_N:
        return ContactReport(load.force, at_tip, None)
    return ContactReport(load.force, at_tip, locate_contact(statics, joints, load, noise))


def _error(values: Array, floor: float) -> float:
    """Return the standard deviation of the mean of rows (m, 3), combined with the error `floor` of any average."""
    spread = float(np.sqrt(values.var(axis=0).mean() / len(values)))
    return math.hypot(spread, floor)


#: Number of telemetry rows of one evaluation (half a second), and their longest time span if rows are missing [s].
WINDOW_ROWS, MAX_WINDOW_S = 250, 0.6
#: Largest motion of a joint during one evaluation [rad, m], that is 10 deg/s and 10 mm/s.
MAX_JOINT_MOTION = {"rotation": np.deg2rad(5.0), "translation": 5e-3}
#: Largest change of the mean force between five equal parts of an evaluation [N]; the position of a
#: swinging load would be estimated wrongly.
MAX_FORCE_CHANGE_N = 0.05
#: Smallest force that can be reported as a contact [N]; a smaller one may be drift of the sensors since the tare.
MIN_SIDE_LOAD_N = 0.1
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
        if estimate is None or estimate.contact is None or float(np.linalg.norm(estimate.force)) < MIN_SIDE_LOAD_N:
            return None
        return SideLoad(estimate.force, estimate.contact)
