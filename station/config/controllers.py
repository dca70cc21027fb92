"""How the tip is controlled, as a file says it: strategy, gains, filters and delays."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from core.control.actuation import Actuation
from core.control.controllers import strategy
from core.control.deflection import RateFilter
from core.control.estimation import Estimator
from core.control.observer import Observer
from core.control.pointing import LEVER, aim
from core.control.spare import Spare
from core.control.step import Controller
from core.model.statics import PAPER_SUBLINK, Statics
from station.config.robots import RobotFile
from station.config.strict import NotNegative, Strict

#: The inner loop's period [s].
PERIOD = 0.002
#: Between two commands to the same one of three axes or fewer, and what each adds, on one line of 9600 baud [s].
THREE_AXES, EACH_AXIS = 0.025, 0.0073
#: Of an observer's bandwidth and the hold: with six axes at 2 Hz the tip hunts by twice what it does at 1 Hz.
HUNTS_NOT = 0.05


class ControllerFile(Strict):
    """How the tip is controlled."""

    strategy: str = "dual_layer"
    """unloaded_jacobian, loaded_jacobian, inner_loop or dual_layer"""
    inner: str = "type_1"
    """of inner_loop and dual_layer: type_1, type_1_exact or type_2"""
    k1: float = 2.5
    """gain of the measured tip in eq. (30), 0 ... 50 [1/s]"""
    k2: float = 2.5
    """gain of the setpoint there, 0 ... 50 [1/s]"""
    feedforward: bool = False
    """add the trajectory's own velocity to eq. (30); without, the tip lags as eq. (31) says"""
    feedback: Literal["tracker", "observer"] = "tracker"
    """what the outer loop looks at: the latest frame as in the paper, or the observed tip of the moment at which
    its command takes effect"""
    deflection_rate: Literal["numerical", "exact"] = "numerical"
    """for type_1: the filtered derivative of Delta_total as in the paper, or C w' + (J(q, w) - J(q, 0)) q'"""
    tip_velocity: Literal["observer", "tracker"] = "observer"
    """for type_2: as observed, or the tracker's frames differentiated, which the paper warns of"""
    task: Literal["position", "position_and_direction", "direction"] = "position"
    """what of the tip is controlled: its place (3 numbers), that and where it points (5), or that alone (2)"""
    direction_weight: Annotated[float, Field(gt=0.0, le=10.0)] = LEVER
    """of a radian beside a metre [m/rad]"""
    spare: Mapping[str, NotNegative] = {}
    """what joints that the task leaves over keep away from, with weights: `stability` (the edge where tubes snap),
    `limits` (ends of travel), `order` (of the tubes)"""
    filter_bandwidth: float = 1.0
    """of the deflection's and the force's rate, greater than 0 and below 250 [Hz]"""
    observer_bandwidth: float | None = None
    """of the model's bias, greater than 0 [Hz]; left out: 0.05 over the hold, 2 Hz at most"""
    hold: float | None = None
    """between two commands to the same stage, planned for, 0 ... 1 [s]; left out: what one line of 9600 baud leaves
    each of the robot's axes, 0.025 s of three and 0.044 s of six"""
    transport: float = 0.012
    """from a command to the motor, planned for, 0 ... 1 [s]"""
    sublink: Annotated[float, Field(ge=0.0005, le=0.05)] = PAPER_SUBLINK
    """length of the model's sub-links [m]"""

    def controller(self, robot: RobotFile) -> Controller:
        """The controller of a robot.

        Raises:
            DescriptionError: unknown strategy or inner loop, a gain, bandwidth or delay out of range.
        """
        hold = max(THREE_AXES, EACH_AXIS * len(robot.joints)) if self.hold is None else self.hold
        bandwidth = HUNTS_NOT / max(hold, THREE_AXES) if self.observer_bandwidth is None else self.observer_bandwidth
        return Controller(
            Statics(robot.robot(), self.sublink),
            strategy(self.strategy, self.k1, self.k2, self.feedforward, self.inner),
            robot.limits(),
            Estimator(
                RateFilter(PERIOD, self.filter_bandwidth),
                Observer(PERIOD, bandwidth=bandwidth),
                Actuation(PERIOD, hold, self.transport),
            ),
            observes=self.feedback == "observer",
            exact_rate=self.deflection_rate == "exact",
            differentiates=self.tip_velocity == "tracker",
            aim=aim(self.task, self.direction_weight),
            spare=Spare(self.spare) if self.spare else None,
        )


#: What follows best in the virtual lab, whatever the load does; the paper's own choices are the defaults above.
BEST = ControllerFile(inner="type_2", feedback="observer", feedforward=True, filter_bandwidth=0.7)
