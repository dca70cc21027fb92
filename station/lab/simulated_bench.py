"""The virtual lab at wire level: the plant, what pulls at it, and around it the devices with their wires.

The stages' units move the true joints; the tracker and a force sensor for each tube see and feel what
comes of it. Bytes and datagrams are all that the other side gets.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from core.errors import NoSolution, PoseError
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile
from station.devices.interfaces import Truth
from station.devices.links.link import Link
from station.devices.links.memory_pipe import memory_pipe
from station.devices.zaber.setup import StageSetup
from station.lab.aurora import wire as aurora_wire
from station.lab.aurora.coil import MOUNT
from station.lab.aurora.simulated import TARGET_SERIAL, SimulatedAurora
from station.lab.aurora.wire import HostPort
from station.lab.config import LabConfig
from station.lab.fault_script import DeviceLine, FaultScript
from station.lab.faults import LabFault
from station.lab.hidden import Hidden
from station.lab.loads import Load, NoLoad
from station.lab.netft.simulated import BoxSettings, SimulatedNetft
from station.lab.netft.wire import DeviceEnd, MemoryDatagrams, MemoryEnd
from station.lab.target import MovingTarget
from station.lab.true_plant import true_plant
from station.lab.zaber import simulated as simulated_zaber
from station.lab.zaber.simulated import SimulatedChain
from station.lab.zaber.unit import Unit, UnitKind

#: Device IDs of the simulated units; those of the real ones are not known here.
ROTARY_ID, LINEAR_ID = 4421, 4332
SERIALS = 1000  #: the device number is added
#: Each force sensor sends 7000/13 records a second. Not 500: a record would have to wait equally long for every
#: poll, and nobody could tell how long; so the wait goes through all lengths and the shortest tells the time.
RECORDS = 7000.0 / 13.0


class Wires(NamedTuple):
    """The devices' ends."""

    zaber: DeviceLine
    aurora: DeviceLine
    netft: tuple[DeviceEnd, ...]  #: one for each tube


class Hosts(NamedTuple):
    """The other ends of wires in memory, for drivers in the same process."""

    zaber: Link
    aurora: HostPort
    netft: tuple[MemoryDatagrams, ...]


def memory_wires(tubes: int) -> tuple[Wires, Hosts]:
    """Wires for virtual time."""
    host, device = memory_pipe("zaber")
    port = HostPort("aurora")
    ends = tuple(MemoryEnd() for _ in range(tubes))
    links = tuple(end.link(f"netft {number}") for number, end in enumerate(ends, 1))
    return Wires(device, port.device, ends), Hosts(host, port, links)


class SimulatedBench:
    """A bench that is not there, seen through its wires. Everything random comes from `seed`."""

    def __init__(
        self,
        robot: RobotFile,
        config: LabConfig,
        seed: int,
        positions: Array,
        wires: Wires | None = None,
        homed: bool = False,
    ) -> None:
        """Stages with the joints really at `positions` (n,).

        Without `wires` they are in memory, and `hosts` are their other ends. The stages have just been
        switched on and know nothing, unless they are `homed`: left on since they were homed.

        Raises:
            PoseError, NoSolution: the true robot cannot stand there.
        """
        # One stream for each part, so that another part does not change what this one draws.
        streams = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5))
        plant, tracker, sensors, unknown, moving = streams
        memory, self.hosts = memory_wires(len(robot.tubes))
        self.config = config
        self._wires = wires or memory
        #: One unit for each joint, numbered from the computer in the robot's order.
        self.setups = tuple(StageSetup.of(joint, number) for number, joint in enumerate(robot.joints, 1))
        places = [
            (q - setup.home_at) / setup.joint.microstep
            for q, setup in zip(positions.tolist(), self.setups, strict=True)
        ]
        self.chain = SimulatedChain(
            [_unit(s, place, homed) for s, place in zip(self.setups, places, strict=True)], seed
        )
        self._axes = [(s.home_at, s.joint.microstep, u) for s, u in zip(self.setups, self.chain.units, strict=True)]
        self.hidden = Hidden(robot, config.hidden, unknown)
        self._off_tip = bool(self.hidden.coil.any())
        second = "" if config.target is None else TARGET_SERIAL
        mount = self.hidden.mount(MOUNT)
        self.aurora = SimulatedAurora(self.hidden.tracker(config.tracker), tracker, mount=mount, target=second)
        self.boxes = tuple(
            SimulatedNetft(end, config.sensors, rng, BoxSettings(rate=RECORDS, serial=f"FT{number:05}"))
            for number, (end, rng) in enumerate(zip(self._wires.netft, sensors.spawn(len(robot.tubes)), strict=True), 1)
        )
        self.faults = FaultScript(robot, self.chain, self.aurora, self.boxes, self._wires[:2])
        self.time = 0.0  #: [s]
        self.trouble = ""  #: why the true robot has stayed where it was; empty when it follows its stages
        self._load: Load = NoLoad()
        self._load_start = 0.0
        at = self.hidden.joints(positions)
        self._plant = true_plant(self.hidden.robot(robot.robot()), config.plant, plant, at)
        self._tells_axis = config.tracker.direction_noise is not None
        self.truth: Truth
        self.truth, self._wrenches = self._plant.advance(at, np.zeros(3))
        self._coil_at = self._coil()
        self._target = None if config.target is None else MovingTarget(config.target, self.truth.tip, moving)
        self._target_at = None if self._target is None else self._target.at(0.0)

    @property
    def positions(self) -> Array:
        """Where the joints really are (n,) [rad or m]."""
        return np.array([at + step * unit.place for at, step, unit in self._axes])

    @property
    def true_robot(self) -> Robot:
        """The robot as it really is."""
        return self._plant.robot

    def true_joints(self, positions: Array) -> Array:
        """Where the joints really are (n,) when the stages count `positions` (n,), play left out."""
        return self.hidden.joints(positions)

    def apply_load(self, load: Load, start: float) -> None:
        """Put a load on the tip whose time counts from `start` [s]."""
        self._load, self._load_start = load, start

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Let these faults happen, instead of those that are on or to come; their time counts from `start` [s].

        Raises:
            ConfigError: one cannot happen to this robot's devices.
        """
        self.faults.inject(faults, start)

    def advance(self, now: float) -> Truth:
        """Let time pass until `now` [s]; what the wires hold was written when time stood still before."""
        if now >= self.faults.due:
            self.faults.apply(now)
        before = self._coil_at
        simulated_zaber.pump(self._wires.zaber, self.chain, now, written=self.time)
        force = self._load.force(now - self._load_start)
        try:
            at = self.hidden.joints(self.positions)
            self.truth, self._wrenches = self._plant.advance(at, force, self._load.contact, now)
            self.trouble = ""
            self._coil_at = self._coil()
            if not self.hidden.felt_as_is:
                self._wrenches = self.hidden.felt(self._wrenches, at)
        except (PoseError, NoSolution) as error:
            # A bench goes on: the robot stays as it was until the stages are back where it can stand.
            self.trouble = str(error)
        axis = self._coil_axis() if self._tells_axis else None
        self.aurora.advance(self.time, now, before, self._coil_at, axis, self._move_target(now))
        aurora_wire.pump(self._wires.aurora, self.aurora, now)
        for number, box in enumerate(self.boxes):
            box.advance(now, self._wrenches[number])
        self.time = now
        return self.truth

    def _move_target(self, now: float) -> tuple[Array, Array] | None:
        """Begin and end of the target's way until `now` [s]."""
        if self._target is None or self._target_at is None:
            return None
        before, self._target_at = self._target_at, self._target.at(now)
        self.truth = self.truth._replace(target=self._target_at)
        return before, self._target_at

    def _coil(self) -> Array:
        """Where the tracker's coil is (3,), world frame [m]."""
        if not self._off_tip:
            return self.truth.tip
        return self.truth.tip + self._plant.rotation @ self.hidden.coil

    def _coil_axis(self) -> Array | None:
        """Where it points (3,), world frame."""
        return self._plant.rotation @ self.hidden.coil_axis if self.hidden.askew else self.truth.direction


def _unit(setup: StageSetup, place: float, homed: bool) -> Unit:
    """The unit of a stage that is `place` from its home sensor's zero [microsteps]."""
    if setup.joint.motion == "rotation":
        kind = UnitKind(ROTARY_ID, None, round(2.0 * np.pi / setup.joint.microstep), serial=SERIALS + setup.device)
    else:
        kind = UnitKind(LINEAR_ID, setup.maximum, serial=SERIALS + setup.device)
    return Unit(kind, setup.device, place, place + setup.home_count if homed else None)
