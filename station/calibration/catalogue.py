"""The calibration procedures: purpose, required equipment, duration and start of each."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from station.calibration import commission, procedures
from station.calibration.plan import PlanSubject
from station.calibration.procedure import Procedure
from station.calibration.procedures import Effort
from station.config.controllers import Present
from station.config.robots import RobotFile
from station.config.strict import ConfigError

#: Known weights that a procedure uses if no others are configured, for a robot that bears them [N].
DEFAULT_WEIGHTS_N = Effort().weights
#: Largest known weight, as a fraction of the largest force on the tip: the true tubes may be softer than described.
WEIGHT_SHARE = 0.75


class ProcedureInfo(NamedTuple):
    """Description of one calibration procedure."""

    title: str
    sentence: str  #: when to use the procedure, and what it does
    needs: str  #: equipment that the operator needs; empty: none
    seconds: float  #: duration with the default poses and weights, handling by the operator included [s]
    weight_seconds: float  #: part of `seconds` that each weight takes [s]
    scales: bool  #: whether the number of poses depends on the effort
    start_procedure: Callable[[PlanSubject, Effort], Procedure[Any]]
    needs_sensors: bool = False  #: whether the procedure needs force sensors; every procedure needs a tracker

    def missing(self, present: Present) -> str:
        """Return which devices of the procedure a bench lacks, as a text; empty if it has all."""
        tracker = "" if present.tracker else "needs a tracker"
        return tracker or ("needs force sensors" if self.needs_sensors and not present.sensors else "")

    @property
    def weighs(self) -> bool:
        """Whether the procedure needs known weights."""
        return self.weight_seconds > 0.0

    def expected(self, effort: float, weights: int) -> float:
        """Return the expected duration with this effort and number of weights [s]."""
        seconds = self.seconds + self.weight_seconds * (weights - len(DEFAULT_WEIGHTS_N))
        return seconds * effort if self.scales else seconds


#: Procedures by name, in the order in which a new bench needs them.
PROCEDURES: Mapping[str, ProcedureInfo] = {
    "axes": ProcedureInfo(
        "Axes",
        "First on a new bench: each joint makes a small move both ways, and the tracker measures its direction.",
        "", 115.0, 0.0, False, lambda subject, _: commission.axes(subject),
    ),
    "latency": ProcedureInfo(
        "Latency",
        "All joints oscillate for 16 s; the delay at which model and tracker agree is the tracker's latency.",
        "", 22.0, 0.0, False, lambda subject, _: commission.latency(subject),
    ),
    "tracker": ProcedureInfo(
        "Tracker",
        "After the field generator or the coil was moved: finds where both are, from poses all over the workspace.",
        "", 320.0, 0.0, True, procedures.tracker,
    ),
    "force": ProcedureInfo(
        "Force sensors",
        "After a force sensor was mounted: finds its orientation and hanging weight, checked with known weights.",
        "known weights, and a thread to hang them at the tip", 740.0, 260.0, True, procedures.force, needs_sensors=True,
    ),
    "tubes": ProcedureInfo(
        "Tubes, tracker and sensors",
        "Everything: stiffness, curvature, lengths and zeros of the tubes, together with tracker, coil and sensors.",
        "known weights, a thread to hang them at the tip, and a caliper: the coil's middle at the tip to 0.3 mm",
        1150.0, 410.0, True, procedures.tubes,
    ),
    "residual": ProcedureInfo(
        "Tubes, and the residual of the model",
        "Like the procedure above, with more poses: also learns the remaining error of the model, and corrects it.",
        "known weights, a thread to hang them at the tip, and a caliper: the coil's middle at the tip to 0.3 mm",
        2900.0, 850.0, True, procedures.residual,
    ),
}  # fmt: skip


def known_weights(robot: RobotFile, weights: tuple[float, ...] = ()) -> tuple[float, ...]:
    """Return the known weights of a procedure [N]: `weights`, or the usual ones, smaller for a soft robot.

    Raises:
        ConfigError: a weight exceeds the largest force on the tip of this robot.
    """
    bound = robot.largest_force()
    if weights and max(weights) > bound.newton:
        raise ConfigError(
            f"a weight of {max(weights):g} N is more than the {bound.newton:.3g} N that '{robot.name}' bears"
            f" ({bound.reason}); use lighter ones"
        )
    scale = min(1.0, WEIGHT_SHARE * bound.newton / max(DEFAULT_WEIGHTS_N))
    return weights or tuple(float(f"{scale * one:.2g}") for one in DEFAULT_WEIGHTS_N)


def start_procedure(
    what: str, subject: PlanSubject, effort: float = 1.0, weights: tuple[float, ...] = ()
) -> Procedure[Any]:
    """Return the procedure `what` at its first step.

    Args:
        what: name of the procedure in `PROCEDURES`.
        subject: the robot with its assumed parameters.
        effort: factor that multiplies the default number of poses.
        weights: known weights that the operator hangs at the tip [N]; empty: the usual ones.

    Raises:
        ConfigError: a weight exceeds the largest force on the tip of this robot.
    """
    chosen = known_weights(subject.file, weights)
    return PROCEDURES[what].start_procedure(subject, replace(Effort().scaled(effort), weights=chosen))
