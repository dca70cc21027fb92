"""Where the robot is touched: rows of telemetry averaged over a moment, and the contact that explains them.

The moment at the bases is redundant for a load at the tip. Single samples are too noisy to use it; half a second of
them is not. For a station's screen: a look takes some ten milliseconds, so it is no part of the loop.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.calibration.contact import LEAST_FORCE, Contact, TipLoad, locate, spans, tip_load
from core.calibration.measurements import Noise
from core.control.force_fusion import Fused
from core.model.solution import pure_force
from core.model.statics import Statics
from core.robot.robot import Array
from station.control.telemetry import Channels

#: What a mean of many samples still has wrong: drift since the tare, mounting, counts [N, N m].
FLOOR = Noise(force=5e-3, moment=0.2e-3)
#: Of chi square with two degrees of freedom, 99 %: a place that explains the moment no better means more noise.
EXPLAINED = 9.21
UNEXPLAINED = "the moments fit no single place well: two contacts, or drift (tare again without load)"
#: Fewer rows than this say nothing about their own noise.
LEAST_ROWS = 20


class Touch(NamedTuple):
    """What the bases say about the load."""

    force: Array  #: (3,) mean [N]
    tip: TipLoad  #: whether the load acts at the tip
    contact: Contact | None  #: where it acts instead; None while the tip explains it, or the force is too small


def look(statics: Statics, channels: Channels, rows: Array) -> Touch | None:
    """The load over rows (m, channels), half a second of a robot that moves slowly; None of too few rows.

    Raises:
        CtrError: the model has no shape under this load.
    """
    if len(rows) < LEAST_ROWS:
        return None
    joints = channels.of(rows, "joints").mean(axis=0)
    forces, moments = channels.of(rows, "force"), channels.of(rows, "moment")
    # Moments are about the plate: noise of the forces at the proximal ends is in them.
    noise = Noise(force=_error(forces, FLOOR.force), moment=_error(moments, FLOOR.moment))
    load = Fused(forces.mean(axis=0), moments.mean(axis=0))
    # Where the model has the tip and where the tracker sees it: an error of one of them is no contact.
    modelled = statics.solve(joints, pure_force(load.force)).tip
    tips = modelled, channels.of(rows, "tip_measured").mean(axis=0)
    touch = _explain(statics, joints, load, tips, noise)
    if touch.contact is not None and touch.contact.statistic > EXPLAINED:
        # The sensors have drifted since they were zeroed, say: both answers have to bear it.
        more = math.sqrt(touch.contact.statistic / 2.0)
        touch = _explain(statics, joints, load, tips, Noise(force=more * noise.force, moment=more * noise.moment))
        contact = touch.contact
        if contact is not None and not contact.located:
            touch = touch._replace(contact=contact._replace(note=f"{UNEXPLAINED}: {spans(contact.intervals)}"))
    return touch


def _explain(statics: Statics, joints: Array, load: Fused, tips: Sequence[Array], noise: Noise) -> Touch:
    """The load by the tip if it can be, else by a contact."""
    at_tip = min((tip_load(load, tip, noise) for tip in tips), key=lambda tested: tested.statistic)
    if at_tip.holds or float(np.linalg.norm(load.force)) < LEAST_FORCE:
        return Touch(load.force, at_tip, None)
    return Touch(load.force, at_tip, locate(statics, joints, load, noise))


def _error(values: Array, floor: float) -> float:
    """Standard deviation of the mean of rows (m, 3), but never below what averaging cannot remove."""
    spread = float(np.sqrt(values.var(axis=0).mean() / len(values)))
    return math.hypot(spread, floor)
