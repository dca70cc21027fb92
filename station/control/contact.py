"""Contact estimation: find the contact on the shaft that explains half a second of telemetry.

For a load at the tip, the measured force determines the moment at the base sensors. A different measured moment shows
that the load acts elsewhere. Single samples are too noisy for this test; half a second of samples is enough. The
station displays the result. One estimate takes about ten milliseconds, so the control loop does not compute it.
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
from core.control.force_fusion import FusedLoad
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.robot import Array
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
    """Return load and contact from half a second of telemetry (m, channels) in slow motion; None for too few rows.

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
