"""The procedures that there are: what each finds, what a person needs for it, how long it takes, how it begins."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from station.calibration import commission, procedures
from station.calibration.plan import Subject
from station.calibration.procedure import Procedure
from station.calibration.procedures import Effort

#: Known weights that a procedure asks for unless one has others [N].
WEIGHTS = Effort().weights


class Offer(NamedTuple):
    """One procedure."""

    title: str
    sentence: str  #: when, and what happens
    needs: str  #: what a person has at hand; empty: nothing
    seconds: float  #: of robot time with the usual poses and weights, persons' work included [s]
    weight_seconds: float  #: for each weight, included in that [s]
    scales: bool  #: takes more or fewer poses
    begin: Callable[[Subject, Effort], Procedure[Any]]

    @property
    def weighs(self) -> bool:
        """Whether the procedure asks for known weights."""
        return self.weight_seconds > 0.0

    def expected(self, effort: float, weights: int) -> float:
        """How long it will take with so many weights [s]."""
        seconds = self.seconds + self.weight_seconds * (weights - len(WEIGHTS))
        return seconds * effort if self.scales else seconds


#: By name, in the order in which a new bench goes through them.
OFFERS: Mapping[str, Offer] = {
    "axes": Offer(
        "Axes",
        "First on a new bench: each joint moves a little either way, and the tracker tells which way it really went.",
        "", 115.0, 0.0, False, lambda subject, _: commission.axes(subject),
    ),
    "latency": Offer(
        "Latency",
        "All joints swing for 16 s; the delay that makes the model meet the tracker is how late the tracker is.",
        "", 22.0, 0.0, False, lambda subject, _: commission.latency(subject),
    ),
    "tracker": Offer(
        "Tracker",
        "After the field generator or the coil was moved: where both are, from poses all over the workspace.",
        "", 320.0, 0.0, True, procedures.tracker,
    ),
    "force": Offer(
        "Force sensors",
        "After a force sensor was mounted: how it stands and what hangs on it, checked by known weights.",
        "known weights, and a way to hang them at the tip", 740.0, 260.0, True, procedures.force,
    ),
    "tubes": Offer(
        "Tubes, tracker and sensors",
        "The whole: stiffness, curvature, lengths and zeros of the tubes, jointly with tracker, coil and sensors.",
        "known weights, a way to hang them at the tip, and a caliper: the coil's middle at the tip to 0.3 mm",
        1150.0, 410.0, True, procedures.tubes,
    ),
}  # fmt: skip


def begin(what: str, subject: Subject, effort: float = 1.0, weights: tuple[float, ...] = WEIGHTS) -> Procedure[Any]:
    """The procedure `what` at its first step.

    Args:
        what: name in `OFFERS`.
        subject: the robot as it is believed to be.
        effort: so many times the usual number of poses.
        weights: known, to be hung at the tip [N].
    """
    return OFFERS[what].begin(subject, replace(Effort().scaled(effort), weights=weights))
