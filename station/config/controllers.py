"""Settings of the controller in files and REST requests: strategy, gains, filters and delays."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field

from core.control.controller_settings import Controller
from core.control.controllers import INNER_LOOPS, STRATEGIES, PositionMode, Strategy, strategy
from core.control.estimation import Actuation, Estimator
from core.control.null_space import NullSpaceObjective
from core.control.observer import Observer, RateFilter
from core.control.stiffness import StiffnessFrame, TipStiffness
from core.control.tip_direction import DEFAULT_LEVER_M, task_selection
from core.control.tip_force import LoadEstimator
from core.errors import DescriptionError
from core.model.statics import Integrator, Statics
from core.robot.robot import Robot
from station.config.plugins import Kind, Setup, made
from station.config.regions import RegionFile, keep_out
from station.config.robots import RobotFile
from station.config.strict import NotNegative, Row, Strict

#: Period of the inner loop and of the whole control loop [s].
PERIOD_S = 0.002
#: Bandwidth of the force filter if the file configures none; an adaptive filter starts with this bandwidth [Hz].
USUAL_BANDWIDTH = 1.0
#: Largest product of observer bandwidth and command interval. The default bandwidth is limited by this product, because
#: with six axes (a command every 44 ms) the tip oscillates twice as far at 2 Hz as at 1 Hz.
MAX_BANDWIDTH_TIMES_INTERVAL = 0.05
#: Factor on the default observer bandwidth of a bench without force sensors. Only the observer then detects a load. At
#: 3 Hz the error under a ramp of 1 s is 0.3 mm smaller than at 2 Hz; at 6 Hz the tracker's noise increases it again.
BANDWIDTH_FACTOR_WITHOUT_SENSORS = 1.5


class StagesLatency(NamedTuple):
    """Latency of velocities on their way to the stages; the default is that of three Zaber T-series stages on one line.

    A velocity takes effect after `delay` and half of `interval` on average.
    """

    interval: float = 0.025  #: time between two velocities that reach the same stage [s]
    delay: float = 0.012  #: time from sending a velocity until the motor receives it [s]


USUAL_LATENCY = StagesLatency()


class Present(NamedTuple):
    """Quantities that a bench measures in addition to its joints."""

    tracker: bool = True  #: the tip, with a tracker
    sensors: bool = True  #: the whole load, with force sensors; false for a sensor on one of several tubes


#: Inner loops that need force sensors, and those that need a tracker.
SENSOR_LOOPS, TRACKER_LOOPS = frozenset({"type_1", "type_1_exact", "loaded"}), frozenset({"type_2"})


StiffnessValue = Annotated[float, Field(ge=1.0, le=1e4)]
#: Stiffness along three axes [N/m].
Stiffness = Annotated[tuple[StiffnessValue, StiffnessValue, StiffnessValue], Row]


class ControllerFile(Strict):
    """Settings of the controller of the tip."""

    strategy: str = "dual_layer"
    """unloaded_jacobian, loaded_jacobian, inner_loop or dual_layer; or the name of an installed outer loop"""
    inner: str = "type_1"
    """inner loop of `inner_loop` and `dual_layer`: type_1, type_1_exact or type_2; or loaded or unloaded, which do not
    compensate the tip's motion by a changing load; or the name of an installed inner loop"""
    tasks: Annotated[tuple[str, ...], Row] = ()
    """names of installed tasks, in addition to the tip's position"""
    limits: Annotated[tuple[str, ...], Row] = ()
    """names of installed limits, in addition to those of the robot"""
    options: Mapping[str, Mapping[str, Any]] = {}
    """keys of each installed loop, task or limit, in a table with its name"""
    k1: float = 2.5
    """gain of the measured tip in eq. (30), 0 ... 50 [1/s]"""
    k2: float = 2.5
    """gain of the setpoint in eq. (30), 0 ... 50 [1/s]; the tip rests at k2 / k1 times its setpoint"""
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
    stiffness: Stiffness | None = None
    """stiffness of the tip along the axes x, y, z of `stiffness_frame`, 1 ... 10000 [N/m]; default: as stiff as the
    joints allow. A tip more than 5 s / T times softer than the tubes along their stiffest direction is refused. T is
    `command_interval` / 2 + `transport_delay` + 0.02 s (+ the observer's time constant without force sensors).
    `PUT /api/stiffness` changes these values within 1 s while a motion runs"""
    stiffness_frame: StiffnessFrame = "world"
    """frame of `stiffness`: world, or tip: the frame of the tip in the loaded model, which turns with the tip. Its z is
    the tangent at the tip. Its x and y are fixed in the innermost tube, and equal those of the front plate if this tube
    is straight and at rotation 0"""
    max_offset: Annotated[float, Field(gt=0.0, le=0.05)] = 0.02
    """largest offset by which the setpoint gives way to a force, with `stiffness` [m]"""
    load: Literal["forces", "wrenches"] = "forces"
    """estimate the force at the tip from the sum of the base forces as in the paper, or from all forces and moments of
    the sensors; a bench without force sensors ignores this key"""
    filter_bandwidth: float | None = None
    """bandwidth of the filters of deflection rate and force, greater than 0 and below 250 [Hz]; default: 1 Hz for
    `load = "forces"`; for `load = "wrenches"` it follows from the estimate's covariance"""
    observer_bandwidth: float | None = None
    """bandwidth of the observer's bias, which corrects the model, greater than 0 [Hz]; default:
    0.05 / `command_interval`, 2 Hz at most; without force sensors 1.5 times as much"""
    command_interval: float | None = None
    """expected time between two velocity commands to the same stage, 0 ... 1 [s]; default: the number of the stages'
    driver, which `ctr-station doctor` prints; 0.025 s for three Zaber T-series stages on one line, 0.044 s for six"""
    transport_delay: float | None = None
    """expected delay from sending a command to its arrival at the motor, 0 ... 1 [s]; default: the number of the
    stages' driver; 0.012 s for Zaber T-series stages on one line"""
    integrator: Integrator | None = None
    """integrator of the model: paper or fourth_order; default: the key `integrator` of the robot's file"""
    sublink: Annotated[float, Field(ge=0.0005, le=0.05)] | None = None
    """length of the model's sub-links [m]; default: 0.010 for the paper's integrator; for fourth_order at most 0.030,
    and short enough for the robot that the tip error stays below 0.05 mm or 0.05 % of the length"""

    def model(self, robot: Robot) -> Statics:
        """Return the model of a robot with the configured integrator, or the one that suits the robot."""
        return Statics(robot, self.sublink, self.integrator)

    def check_devices(self, present: Present) -> None:
        """Refuse settings whose inputs a bench does not measure.

        Raises:
            DescriptionError: the text names the setting, the missing device and a setting that fits.
        """
        fits = default_controller(present)
        uses_inner = self.strategy not in ("unloaded_jacobian", "loaded_jacobian")
        for device, missing, wrong in (
            ("force sensors", not present.sensors, {
                "strategy": ({"loaded_jacobian"}, "unloaded_jacobian"),
                "inner": (SENSOR_LOOPS if uses_inner else (), fits.inner),
            }),
            ("a tracker", not present.tracker, {
                "inner": (TRACKER_LOOPS if uses_inner else (), fits.inner),
                "feedback": ({"tracker"}, "observer"),
                "tip_velocity": ({"tracker"}, "observer"),
            }),
        ):  # fmt: skip
            for key, (refused, instead) in wrong.items() if missing else ():
                if getattr(self, key) in refused:
                    raise DescriptionError(
                        f"controller.{key} = '{getattr(self, key)}' needs {device}, which this bench does not have;"
                        f" use '{instead}'"
                    )

    def controller(
        self,
        robot: RobotFile,
        present: Present = Present(),  # noqa: B008 - immutable
        regions: Sequence[RegionFile] = (),
        latency: StagesLatency = USUAL_LATENCY,
    ) -> Controller:
        """Return the controller of a robot on a bench with these devices and forbidden or allowed `regions`.

        `latency` is that of the stages' driver; the keys `command_interval` and `transport_delay` override it.

        Raises:
            DescriptionError: the strategy or inner loop is unknown, needs a device that the bench does not have, or a
                gain, bandwidth or delay is out of range.
            ConfigError: the file of a region's mesh cannot be read, or two regions have one name.
        """
        self.check_devices(present)
        custom = partial(self._installed, robot.robot())
        interval = latency.interval if self.command_interval is None else self.command_interval
        bandwidth = (
            (1.0 if present.sensors else BANDWIDTH_FACTOR_WITHOUT_SENSORS)
            * MAX_BANDWIDTH_TIMES_INTERVAL
            / max(interval, USUAL_LATENCY.interval)
            if self.observer_bandwidth is None
            else self.observer_bandwidth
        )
        limits = robot.limits()
        moments = self.load == "wrenches" and present.sensors
        return Controller(
            self.model(robot.robot()),
            self._strategy(custom),
            replace(
                limits, others=(*limits.others, *keep_out(regions), *(custom("limits", name) for name in self.limits))
            ),
            Estimator(
                RateFilter(PERIOD_S, USUAL_BANDWIDTH if self.filter_bandwidth is None else self.filter_bandwidth),
                Observer(PERIOD_S, bandwidth=bandwidth),
                Actuation(PERIOD_S, interval, latency.delay if self.transport_delay is None else self.transport_delay),
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
            tasks=tuple(custom("tasks", name) for name in self.tasks),
            null_space=NullSpaceObjective(self.null_space) if self.null_space else None,
            tracked=present.tracker,
            senses=present.sensors,
            stiffness=(
                None if self.stiffness is None else TipStiffness(self.stiffness, self.max_offset, self.stiffness_frame)
            ),
        )

    def _strategy(self, custom: Callable[[Kind, str], Any]) -> Strategy:
        """Return the outer and the inner loop."""
        names = {self.strategy, self.inner, *self.tasks, *self.limits}
        if unused := sorted(self.options.keys() - names):
            raise DescriptionError(
                f"controller.options.{unused[0]}: this controller uses no installed code of that name"
            )
        inner = INNER_LOOPS[self.inner] if self.inner in INNER_LOOPS else custom("inner_loops", self.inner)
        if self.strategy in STRATEGIES:
            return strategy(self.strategy, self.k1, self.k2, self.feedforward, inner)
        return Strategy(custom("outer_loops", self.strategy), inner)

    def _installed(self, robot: Robot, kind: Kind, name: str) -> Any:
        """Return the installed code `name`, made from its own keys in the file; see `plugins.made`."""
        key, built_in = _KEYS_OF_INSTALLED[kind]
        gains = PositionMode(self.k1, self.k2, self.feedforward)
        setup = Setup(self.options.get(name, {}), robot, PERIOD_S, gains)
        return made(kind, name, f"controller.{key}", setup, tuple(built_in))


#: Key of the file and built-in names of each kind of installed code.
_KEYS_OF_INSTALLED: dict[Kind, tuple[str, Iterable[str]]] = {
    "outer_loops": ("strategy", STRATEGIES), "inner_loops": ("inner", INNER_LOOPS),
    "tasks": ("tasks", ()), "limits": ("limits", ()),
}  # fmt: skip
#: Controller with the smallest errors in the virtual lab under all loads. The defaults above are the paper's choices.
DEFAULT_CONTROLLER = ControllerFile(inner="type_2", feedback="observer", feedforward=True, load="wrenches")


def default_controller(present: Present) -> ControllerFile:
    """Return the controller with the smallest errors in the virtual lab among those that a bench's devices allow.

    Without force sensors the observer attributes the whole deflection to the model's bias. Without a tracker the
    observer's tip is the model's tip.
    """
    inner = "type_2" if present.tracker else "type_1_exact" if present.sensors else "unloaded"
    return DEFAULT_CONTROLLER.model_copy(update={"inner": inner})
