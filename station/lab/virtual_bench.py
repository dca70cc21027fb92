"""Benches in virtual time: the plant with ideal devices, or simulated devices with the drivers of a real bench."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from core.control.controller_settings import Controller
from core.control.estimation import estimate
from core.control.rehearsal import rehearse
from core.model.solution import at_rest
from core.robot.robot import Array, Robot
from station.config.controllers import PERIOD_S
from station.config.loads import Load
from station.config.robots import RobotFile
from station.config.strict import ConfigError
from station.control.loop import ControlLoop
from station.control.states import State
from station.devices.ati.calibration import read_page
from station.devices.ati.netft import NetftSensors
from station.devices.aurora.dialogue import AuroraSettings, Coil
from station.devices.aurora.tracker import AuroraTracker, TrackerMounting
from station.devices.cameras import CalibratedView, measuring
from station.devices.interfaces import (
    Condition,
    DeviceFault,
    Devices,
    GroundTruth,
    JointReading,
    Stages,
    TipReading,
    WrenchReading,
)
from station.devices.stereo.tracker import StereoTracker
from station.lab.aurora_coil import assumed_mounting
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.frictional_plant import true_plant
from station.lab.plant import on_sensors
from station.lab.simulated_aurora import TARGET_SERIAL
from station.lab.simulated_bench import SimulatedBench
from station.lab.simulated_line import pump
from station.lab.simulated_stages import STAGES, simulated_stages
from station.lab.tip_contact import LoadedPlant
from station.lab.wires import HostPort


class IdealLab:
    """The plant with its load and ideal devices, which have no wires."""

    trouble = ""  #: always empty: if the plant (simulated real robot) cannot follow its stages, `advance` raises

    def __init__(self, robot: RobotFile, config: LabConfig, seed: int, positions: Array) -> None:
        """Create the lab with the joints at `positions` (n,).

        Raises:
            PoseError, NoSolution: the plant (simulated real robot) has no shape there.
        """
        self._plant = true_plant(robot.robot(), config.plant, np.random.default_rng(seed), positions)
        self._stages = IdealStages(robot, positions)
        self._tracker = IdealTracker(config.tracker.rate)
        self._sensors = IdealSensors()
        self._loaded = LoadedPlant(self._plant)
        self.devices = Devices(self._stages, self._tracker, self._sensors)
        self.advance(0.0)

    @property
    def true_robot(self) -> Robot:
        """The robot with its true parameters."""
        return self._plant.robot

    def true_joints(self, positions: Array) -> Array:
        """Return the true joint positions (n,) for the stages' counts `positions` (n,), which are equal here."""
        return positions

    def apply_load(self, load: Load, start: float) -> None:
        """Apply a load to the tip; the load's time counts from `start` [s]."""
        self._loaded.apply(load, start)

    def inject(self, faults: Sequence[LabFault], start: float) -> None:  # noqa: ARG002 - there are no wires
        """Refuse faults: ideal devices have none.

        Raises:
            ConfigError: faults were requested.
        """
        if faults:
            raise ConfigError("faults: ideal devices have none; use a lab with devices = 'wire'")

    def advance(self, now: float) -> GroundTruth:
        """Advance the simulation until `now` [s].

        Raises:
            PoseError, NoSolution: the plant (simulated real robot) has no shape.
        """
        self._stages.advance(now)
        truth, wrenches = self._loaded.advance(self._stages.positions, now)
        self._tracker.direction = truth.direction
        felt = on_sensors(self._plant.robot, self._plant.tubes_at, wrenches)
        self._tracker.tip, self._sensors.reading = truth.tip, WrenchReading(now, felt)
        return truth


class _Faultless:
    """Base class of devices that are always connected and never fail."""

    condition = Condition.CONNECTED
    ready = True

    def connect(self, now: float) -> None:
        """Nothing to do: an ideal device is always connected."""

    def home(self, now: float) -> None:
        """Nothing to do: ideal stages are always homed."""

    def trouble(self, now: float) -> DeviceFault | None:  # noqa: ARG002 - it has no faults
        """Return None, because an ideal device has no faults."""
        return None

    def details(self) -> Mapping[str, Any]:
        """Return an empty mapping, because an ideal device has no identity and no counters."""
        return {}

    def close(self) -> None:
        """Nothing to do: an ideal device has no ports."""


class IdealStages(_Faultless):
    """Motors that run at the commanded velocity without delay, up to the end of the travel."""

    def __init__(self, robot: RobotFile, positions: Array) -> None:
        self.positions = positions.copy()  #: (n,) [rad or m]
        self._lower = np.array([joint.lower for joint in robot.joints])
        self._upper = np.array([joint.upper for joint in robot.joints])
        self._speed = np.array([joint.speed for joint in robot.joints])
        self._velocity = np.zeros(len(robot.joints))
        self._time = 0.0

    def poll(self, now: float) -> JointReading:  # noqa: ARG002 - the lab has moved to `now` already
        """Return positions and velocities."""
        return JointReading(self.positions.copy(), self._velocity.copy())

    def command(self, velocities: Array, now: float) -> None:  # noqa: ARG002 - without delay
        """Set the velocities (n,)."""
        self._velocity = np.minimum(np.maximum(velocities, -self._speed), self._speed)

    def stop(self, now: float) -> None:  # noqa: ARG002 - without delay
        """Stop all joints."""
        self._velocity = np.zeros_like(self._velocity)

    def advance(self, now: float) -> None:
        """Move the joints until `now` [s]."""
        reached = self.positions + (now - self._time) * self._velocity
        self.positions, self._time = np.minimum(np.maximum(reached, self._lower), self._upper), now


class IdealTracker(_Faultless):
    """Tracker that reports the true tip without noise and delay."""

    def __init__(self, rate: float) -> None:
        self.tip = np.zeros(3)  #: true position [m]
        self.direction: Array | None = None  #: (3,) true direction
        self._rate, self._frame = rate, -1

    def poll(self, now: float) -> TipReading | None:
        """Return the frame at `now`; None if there is no new frame."""
        frame = int(now * self._rate + 1e-6)
        if frame == self._frame:
            return None
        self._frame = frame
        return TipReading(frame, now, self.tip.copy(), direction=self.direction)


class IdealSensors(_Faultless):
    """Base sensors that report the true wrenches."""

    reading: WrenchReading

    def poll(self, now: float) -> WrenchReading:  # noqa: ARG002 - the lab has moved to `now` already
        """Return the present wrenches."""
        return self.reading


Lab = IdealLab | SimulatedBench


class VirtualBench(NamedTuple):
    """A lab and the drivers of its devices."""

    lab: Lab
    devices: Devices


def virtual_bench(
    robot: RobotFile, config: LabConfig, seed: int, positions: Array, registration: TrackerMounting | None = None,
    views: Mapping[str, CalibratedView] = MappingProxyType({}),
) -> VirtualBench:  # fmt: skip
    """Return a bench with homed stages and the joints at `positions` (n,); nothing is connected yet.

    `seed` determines everything random. `registration` is the pose of the tracker that the driver assumes; by default
    it is the nominal pose in the lab. `views` are the calibrated lenses and poses of the cameras that measure the tip;
    by default their nominal ones.

    Raises:
        PoseError, NoSolution: the plant (simulated real robot) has no shape there.
    """
    if config.devices == "ideal":
        lab: Lab = IdealLab(robot, config, seed, positions)
        devices = lab.devices
    else:
        lab = SimulatedBench(robot, config, seed, positions, homed=True)
        devices = drivers(lab, registration, views)
    return VirtualBench(lab, replace(devices, **dict.fromkeys(config.without)))


def stages_alone(
    robot: RobotFile, config: LabConfig, seed: int, positions: Sequence[float]
) -> tuple[Stages, Callable[[float, float], None]]:
    """Return the driver of a lab's stages without tubes, and a function that simulates them between two times [s]."""
    kind = STAGES[config.stages]
    _, simulated = simulated_stages(robot, kind, positions, True, seed, config.variant)
    host = HostPort("stages")
    return kind.on(host, robot), lambda since, until: pump(host.device, simulated, until, written=since)


def drivers(
    lab: SimulatedBench, registration: TrackerMounting | None = None,
    views: Mapping[str, CalibratedView] = MappingProxyType({}),
) -> Devices:  # fmt: skip
    """Return drivers that use the host ends of the lab's wires in memory; see `virtual_bench` for the arguments."""
    mounting = registration or assumed_mounting(lab.config)
    return Devices(
        STAGES[lab.config.stages].on(lab.hosts.stages, lab.robot),
        StereoTracker(lab.hosts.cameras, measuring(lab.config.cameras, views), mounting)
        if lab.config.cameras
        else _aurora(lab, mounting),
        NetftSensors(lab.hosts.netft, [read_page(box.page() or b"") for box in lab.boxes]),
    )


def _aurora(lab: SimulatedBench, mounting: TrackerMounting) -> AuroraTracker:
    tracker = lab.config.tracker
    settings = AuroraSettings(
        target=None if lab.config.target is None else Coil(TARGET_SERIAL),
        frame_rate=tracker.rate,
        latency=tracker.latency,
        measures_axis=tracker.direction_noise is not None,
    )
    return AuroraTracker(lab.hosts.aurora, settings, mounting)


#: Largest number of ticks in which a bench in memory has to reach READY, and number of ticks to run in READY.
WARMUP_TICKS, READY_TICKS = 1500, 50
#: Number of ticks with ideal devices; the loop writes its first rows of telemetry in them.
IDEAL_TICKS = 10


def warm_up_control(
    robot: RobotFile, config: LabConfig, seed: int, park: tuple[float, ...], controller: Controller, *,
    all_features: bool = True,
) -> None:  # fmt: skip
    """Compile all code that a tick can call, by running the control loop on a simulated bench in memory.

    Otherwise a tick of the running station would wait for the compiler and be late. The estimation comes first: in a
    new installation another process compiles the model meanwhile, which the estimation does not need.

    Args:
        robot: robot of the station.
        config: configuration of the virtual lab.
        seed: seed of everything random in the lab.
        park: joint positions at power-up [rad or m].
        controller: controller of the station.
        all_features: whether motions may later choose other features than those of this controller.
    """
    joints, tubes = np.array(park), len(robot.tubes)
    rest, zero = at_rest(joints, math.inf, tubes), np.zeros(3)
    now = controller.estimator.start(rest, rest, zero, zero)
    before = (rest.numbers, rest.numbers, now.numbers)
    estimate(controller.estimator.settings, *before[:2], *before, zero, joints, zero, -1.0, now.numbers.copy())
    rehearse(controller, joints, all_features=all_features)
    # The loop writes telemetry only if its stages are ready. Ideal stages are ready at once, wired ones perhaps never.
    config = config.model_copy(update={"cameras": {}})
    lab, devices = virtual_bench(robot, config.model_copy(update={"devices": "ideal"}), seed, joints)
    loop = ControlLoop(controller, devices)
    loop.connect(0.0)
    for tick in range(IDEAL_TICKS):
        loop.tick(tick * PERIOD_S, lab.advance(tick * PERIOD_S))
    # Compile the drivers' code, too: a driver that compiles at its first frame or record would report a dead device.
    # A simulated camera would import OpenCV, which the control process does not need.
    lab, devices = virtual_bench(robot, config, seed, joints)
    loop = ControlLoop(controller, devices)
    loop.connect(0.0)
    ready = 0
    for tick in range(WARMUP_TICKS):
        lab.advance(tick * PERIOD_S)
        loop.tick(tick * PERIOD_S)
        ready += loop.state is State.READY
        if ready == READY_TICKS:
            break
