"""The virtual lab at wire level: the plant with its load, and the simulated devices with their wires.

The simulated stages move the true joints; the tracker and the force sensors measure the resulting shape. The
station's drivers receive only bytes and datagrams from this bench.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from core.errors import ContractError, NoSolution, PoseError
from core.robot.robot import Array, Robot
from station.config.loads import Load
from station.config.robots import RobotFile
from station.devices.interfaces import GroundTruth
from station.lab import simulated_aurora, simulated_line
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import LabConfig, TargetConfig
from station.lab.faults import FaultScript, LabFault
from station.lab.frictional_plant import true_plant
from station.lab.plant import TubeShape
from station.lab.simulated_aurora import TARGET_SERIAL, SimulatedAurora
from station.lab.simulated_netft import BoxSettings, SimulatedNetft
from station.lab.simulated_stages import STAGES, simulated_stages
from station.lab.tip_contact import LoadedPlant
from station.lab.unmodelled_errors import UnmodelledErrors, random_direction
from station.lab.wires import Wires, memory_wires

if TYPE_CHECKING:
    from station.lab.simulated_cameras import SimulatedCamera

#: Periods with which rate and size of the target's oscillations drift [s].
RATE_DRIFT_PERIOD_S, SIZE_DRIFT_PERIOD_S = 60.0, 45.0


class TargetWaves(NamedTuple):
    """One of the two oscillations of the target along a line: breathing or heartbeat."""

    amplitude: Array  #: (3,) displacement from the middle to the end of the line [m]
    rate: float  #: mean frequency of the oscillation [Hz]
    second: float  #: amplitude at twice the rate, as a fraction of the amplitude at the rate
    rate_drift: float  #: largest change of the rate in both directions, as a fraction
    size_drift: float  #: largest change of the amplitude in both directions, as a fraction
    phases: tuple[float, float, float]  #: phases at 0 s of the oscillation and of the drifts of rate and size [rad]

    def at(self, time: float) -> Array:
        """Return the displacement (3,) from the target's middle [m]."""
        own, of_rate, of_size = self.phases
        turn = 2.0 * math.pi
        # The phase of the oscillation is the integral of its drifting rate; `drift` is the part caused by the drift.
        drift = (
            self.rate_drift
            * RATE_DRIFT_PERIOD_S
            / turn
            * (math.cos(of_rate) - math.cos(turn * time / RATE_DRIFT_PERIOD_S + of_rate))
        )
        phase = turn * self.rate * (time + drift) + own
        size = 1.0 + self.size_drift * math.sin(turn * time / SIZE_DRIFT_PERIOD_S + of_size)
        return self.amplitude * (size * (math.sin(phase) + self.second * math.cos(2.0 * phase)))


class MovingTarget:
    """Position of the target as a function of time; its lines and phases are drawn once.

    The target breathes along one line and beats like a heart along a second line. Rate and size of both oscillations
    drift, so that the station has to predict a target that is not exactly periodic.
    """

    def __init__(self, config: TargetConfig, tip: Array, rng: np.random.Generator) -> None:
        """The target's middle is at the configured offset from `tip` (3,) [m]."""
        self._middle = tip + np.array(config.place)
        self._motions = tuple(
            TargetWaves(
                size * random_direction(rng), rate, second, config.rate_drift, config.size_drift,
                tuple(rng.uniform(0.0, 2.0 * math.pi, 3).tolist()),
            )
            for size, rate, second in (
                (config.breathing, config.breathing_rate, config.breathing_second),
                (config.heartbeat, config.heartbeat_rate, 0.0),
            )
        )  # fmt: skip

    def at(self, time: float) -> Array:
        """Return the position of the target (3,) at `time` [s], world frame [m]."""
        breathing, heartbeat = self._motions
        return self._middle + breathing.at(time) + heartbeat.at(time)


#: Records per second of each force sensor, 7000/13. At 500 per second, every record would wait equally long for the
#: next poll, and its age would be unknown. At this rate the waits vary; the shortest gives the time of the measurement.
FORCE_RECORD_RATE_HZ = 7000.0 / 13.0


class SimulatedBench:
    """A simulated bench with its wires. `seed` determines everything random."""

    def __init__(
        self,
        robot: RobotFile,
        config: LabConfig,
        seed: int,
        positions: Array,
        wires: Wires | None = None,
        homed: bool = False,
    ) -> None:
        """Create the bench with the true joints at `positions` (n,).

        Without `wires` the bench creates wires in memory, whose other ends are `hosts`. Unless `homed`, the stages have
        just been switched on and are not homed.

        Raises:
            PoseError, NoSolution: the plant (simulated real robot) has no shape there.
        """
        # Each part of the bench has a separate random stream, so that the parts do not change each other's draws.
        streams = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5))
        plant, tracker, sensors, unknown, moving = streams
        memory, self.hosts = memory_wires(len(robot.sensor_names), config.stages)
        self.config, self.robot = config, robot
        self._wires = wires or memory
        self.setups, self.chain = simulated_stages(
            robot, STAGES[config.stages], positions.tolist(), homed, seed, config.variant
        )
        self._axes = [(s.home_at, s.joint.microstep, u) for s, u in zip(self.setups, self.chain.units, strict=True)]
        self.hidden = UnmodelledErrors(robot, config.hidden, unknown)
        self._off_tip = bool(self.hidden.coil.any())
        second = "" if config.target is None else TARGET_SERIAL
        mount = self.hidden.mount(GENERATOR_POSE)
        self.aurora = SimulatedAurora(self.hidden.tracker(config.tracker), tracker, mount=mount, target=second)
        self.boxes = tuple(
            SimulatedNetft(end, config.sensors, rng, BoxSettings(rate=FORCE_RECORD_RATE_HZ, serial=f"FT{number:05}"))
            for number, (end, rng) in enumerate(
                zip(self._wires.netft, sensors.spawn(len(self._wires.netft)), strict=True), 1
            )
        )
        self._cameras: tuple[SimulatedCamera, ...] = ()
        if config.cameras and wires is None:  # in the live lab, the cameras' processes render the pictures
            from station.lab.simulated_cameras import simulated_cameras  # imports OpenCV

            self._cameras = simulated_cameras(config.cameras, robot.robot(), seed)
        self.faults = FaultScript(robot, self.chain, self.aurora, self.boxes, self._wires[:2])
        self.time = 0.0  #: time up to which the bench is simulated [s]
        self.trouble = ""  #: why the plant (simulated real robot) cannot follow its stages; empty if it follows
        joints = self.hidden.joints(positions)
        self._plant = true_plant(self.hidden.robot(robot.robot()), config.plant, plant, joints)
        self._loaded = LoadedPlant(self._plant)
        self._reports_axis = config.tracker.direction_noise is not None
        self.truth: GroundTruth
        self.truth, wrenches = self._plant.advance(joints, np.zeros(3))
        self._wrenches = self.hidden.felt(wrenches, joints, self._plant.tubes_at)
        self._coil_position = self._coil()
        self._target = None if config.target is None else MovingTarget(config.target, self.truth.tip, moving)
        self._target_position = None if self._target is None else self._target.at(0.0)

    @property
    def positions(self) -> Array:
        """Joint positions (n,) from the true positions of the stages, without the hidden errors [rad or m]."""
        return np.array([home + step * unit.true_position for home, step, unit in self._axes])

    @property
    def true_robot(self) -> Robot:
        """The robot with its true parameters."""
        return self._plant.robot

    def true_joints(self, positions: Array) -> Array:
        """Return the true joint positions (n,), without play, for the stages' counts `positions` (n,)."""
        return self.hidden.joints(positions)

    def shape(self) -> TubeShape:
        """Return the true shape at the last tick, for simulated cameras."""
        return self._plant.shape()

    def apply_load(self, load: Load, start: float) -> None:
        """Apply a load to the tip; the load's time counts from `start` [s]."""
        self._loaded.apply(load, start)

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Replace all active and planned faults; times count from `start` [s].

        Raises:
            ConfigError: this robot's devices cannot have one of the faults.
        """
        self.faults.inject(faults, start)

    def advance(self, now: float) -> GroundTruth:
        """Advance the simulation until `now` [s]; bytes on the wires count as written at the previous time."""
        if now >= self.faults.due:
            self.faults.apply(now)
        before = self._coil_position
        simulated_line.pump(self._wires.stages, self.chain, now, written=self.time)
        try:
            joints = self.hidden.joints(self.positions)
            self.truth, self._wrenches = self._loaded.advance(joints, now)
            self.trouble = ""
            self._coil_position = self._coil()
            if self.hidden.changes_wrenches:
                self._wrenches = self.hidden.felt(self._wrenches, joints, self._plant.tubes_at)
        except (PoseError, NoSolution, ContractError) as error:
            # A real bench would continue: the robot keeps its shape until the stages are back at a possible pose.
            self.trouble = str(error)
        target = None if self._target is None else self._move_target(now)
        if self.aurora.measures_by(now):
            axis = self._coil_axis() if self._reports_axis else None
            self.aurora.advance(self.time, now, before, self._coil_position, axis, target)
        simulated_aurora.pump(self._wires.aurora, self.aurora, now)
        for camera in self._cameras:
            if (datagram := camera.advance(now, self.shape)) is not None:
                self.hosts.cameras.put(datagram)
        for box, wrench in zip(self.boxes, self._wrenches, strict=True):
            box.advance(now, wrench)
        self.time = now
        return self.truth

    def _move_target(self, now: float) -> tuple[Array, Array] | None:
        """Move the target until `now` [s], and return its previous and present positions."""
        if self._target is None or self._target_position is None:
            return None
        before, self._target_position = self._target_position, self._target.at(now)
        self.truth = self.truth._replace(target=self._target_position)
        return before, self._target_position

    def _coil(self) -> Array:
        """Return the position of the tracker's coil (3,), world frame [m]."""
        if not self._off_tip:
            return self.truth.tip
        return self.truth.tip + self._plant.rotation @ self.hidden.coil

    def _coil_axis(self) -> Array | None:
        """Return the direction of the coil's axis (3,), world frame."""
        return self._plant.rotation @ self.hidden.coil_axis if self.hidden.misaligned else self.truth.direction
