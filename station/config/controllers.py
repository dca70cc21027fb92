"""Settings of the controller in files and REST requests: strategy, gains, filters and delays."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from core.control.controllers import strategy
from core.control.estimation import Actuation, Estimator
from core.control.null_space import NullSpaceObjective
from core.control.observer import Observer, RateFilter
from core.control.step import Controller
from core.control.tip_direction import DEFAULT_LEVER_M, task_selection
from core.control.tip_force import LoadEstimator
from core.model.statics import (
    MAX_SUBLINK_BEND_RAD,
    PAPER_SUBLINK_M,
    Integrator,
    Statics,
    sublink_bend,
    suitable_integrator,
)
from core.robot.robot import Robot
from station.config.robots import RobotFile
from station.config.strict import NotNegative, Strict

#: Period of the inner loop and of the whole control loop [s].
PERIOD_S = 0.002
#: Time between two commands to the same axis on one line of 9600 baud [s]: for up to three axes, and the time per axis
#: for more axes.
COMMAND_INTERVAL_THREE_AXES_S, COMMAND_INTERVAL_PER_AXIS_S = 0.025, 0.0073
#: Bandwidth of the force filter if the file configures none; an adaptive filter starts with this bandwidth [Hz].
USUAL_BANDWIDTH = 1.0
#: Largest product of observer bandwidth and command interval. The default bandwidth is limited by this product, because
#: with six axes (a command every 44 ms) the tip oscillates twice as far at 2 Hz as at 1 Hz.
MAX_BANDWIDTH_TIMES_INTERVAL = 0.05


class ControllerFile(Strict):
    """Settings of the controller of the tip."""

    strategy: str = "dual_layer"
    """unloaded_jacobian, loaded_jacobian, inner_loop or dual_layer"""
    inner: str = "type_1"
    """inner loop of `inner_loop` and `dual_layer`: type_1, type_1_exact or type_2"""
    k1: float = 2.5
    """gain of the measured tip in eq. (30), 0 ... 50 [1/s]"""
    k2: float = 2.5
    """gain of the setpoint in eq. (30), 0 ... 50 [1/s]"""
    feedforward: bool = False
    """add the trajectory's velocity to eq. (30); without it the tip lags as in eq. (31)"""
    feedback: Literal["tracker", "observer"] = "tracker"
    """input of the outer loop: the latest tracker frame as in the paper, or the observer's estimate of the tip for the
    time at which the command takes effect"""
    deflection_rate: Literal["numerical", "exact"] = "numerical"
    """for type_1: the filtered derivative of Delta_total as in the paper, or C w' + (J(q, w) - J(q, 0)) q'"""
    tip_velocity: Literal["observer", "tracker"] = "observer"
    """for type_2: the observer's estimate, or the derivative of the tracker's frames (the paper advises against it)"""
    task: Literal["position", "position_and_direction", "direction"] = "position"
    """controlled quantities: position of the tip (3 numbers), position and direction (5), or direction only (2)"""
    direction_weight: Annotated[float, Field(gt=0.0, le=10.0)] = DEFAULT_LEVER_M
    """weight of a radian of direction error relative to a metre of position error [m/rad]"""
    null_space: Mapping[str, NotNegative] = {}
    """weights of the null-space objective, which keeps redundant joints away from: `stability` (the edge where tubes
    snap), `limits` (ends of travel), `order` (of the tubes)"""
    load: Literal["forces", "wrenches"] = "forces"
    """estimate the force at the tip from the sum of the base forces as in the paper, or from all forces and moments"""
    filter_bandwidth: float | None = None
    """bandwidth of the filters of deflection rate and force, greater than 0 and below 250 [Hz]; default: 1 Hz for
    `load = "forces"`; for `load = "wrenches"` it follows from the estimate's covariance"""
    observer_bandwidth: float | None = None
    """bandwidth of the observer's bias, which corrects the model, greater than 0 [Hz]; default:
    0.05 / `command_interval`, 2 Hz at most"""
    command_interval: float | None = None
    """expected time between two velocity commands to the same stage, 0 ... 1 [s]; default: what one line of 9600 baud
    allows, 0.025 s for three axes and 0.044 s for six"""
    transport_delay: float = 0.012
    """expected delay from sending a command to its arrival at the motor, 0 ... 1 [s]"""
    integrator: Integrator | None = None
    """integrator of the model: paper or fourth_order; default: paper, or fourth_order if a tube's curvature times the
    length of the sub-link exceeds 0.08 rad"""
    sublink: Annotated[float, Field(ge=0.0005, le=0.05)] | None = None
    """length of the model's sub-links [m]; default: 0.010 for the paper's integrator, 0.030 for fourth_order"""

    def model(self, robot: Robot) -> Statics:
        """Return the model of a robot with the integrator that its curvature requires."""
        kind = self.integrator or suitable_integrator(robot, self.sublink or PAPER_SUBLINK_M)
        return Statics(robot, self.sublink, kind)

    def model_note(self, robot: Robot) -> str:
        """Return which integrator the curvature requires, and why; empty for the paper's or a configured one."""
        sublink = self.sublink or PAPER_SUBLINK_M
        if self.integrator is not None or suitable_integrator(robot, sublink) == "paper":
            return ""
        return (
            f"model: fourth-order integrator, sub-links of {1e3 * self.model(robot).step:g} mm, because a tube of"
            f" '{robot.name}' bends by {sublink_bend(robot, sublink):.2g} rad in {1e3 * sublink:g} mm"
            f" (paper's integrator: up to {MAX_SUBLINK_BEND_RAD:g} rad)"
        )

    def controller(self, robot: RobotFile) -> Controller:
        """Return the controller of a robot.

        Raises:
            DescriptionError: the strategy or inner loop is unknown, or a gain, bandwidth or delay is out of range.
        """
        command_interval = (
            max(COMMAND_INTERVAL_THREE_AXES_S, COMMAND_INTERVAL_PER_AXIS_S * len(robot.joints))
            if self.command_interval is None
            else self.command_interval
        )
        bandwidth = (
            MAX_BANDWIDTH_TIMES_INTERVAL / max(command_interval, COMMAND_INTERVAL_THREE_AXES_S)
            if self.observer_bandwidth is None
            else self.observer_bandwidth
        )
        moments = self.load == "wrenches"
        return Controller(
            self.model(robot.robot()),
            strategy(self.strategy, self.k1, self.k2, self.feedforward, self.inner),
            robot.limits(),
            Estimator(
                RateFilter(PERIOD_S, USUAL_BANDWIDTH if self.filter_bandwidth is None else self.filter_bandwidth),
                Observer(PERIOD_S, bandwidth=bandwidth),
                Actuation(PERIOD_S, command_interval, self.transport_delay),
                LoadEstimator(
                    moments,
                    adapts=moments and self.filter_bandwidth is None,
                    tracks_zeros=moments and self.feedback == "observer",
                ),
            ),
            observes=self.feedback == "observer",
            exact_rate=self.deflection_rate == "exact",
            differentiates=self.tip_velocity == "tracker",
            aim=task_selection(self.task, self.direction_weight),
            null_space=NullSpaceObjective(self.null_space) if self.null_space else None,
        )


#: Controller with the smallest errors in the virtual lab under all loads. The defaults above are the paper's choices.
DEFAULT_CONTROLLER = ControllerFile(inner="type_2", feedback="observer", feedforward=True, load="wrenches")
