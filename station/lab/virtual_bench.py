"""A bench in virtual time: the plant, its simulated devices, and the drivers that a real bench has too."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from core.robot.robot import Array, Robot
from station.config.robots import RobotFile
from station.devices.aurora.settings import AuroraSettings
from station.devices.aurora.tracker import AuroraTracker, Registration
from station.devices.interfaces import Devices, Truth
from station.devices.links.link import reopen
from station.devices.netft.page import read_page
from station.devices.netft.sensors import NetftSensors
from station.devices.zaber.setup import Port
from station.devices.zaber.stages import ZaberStages
from station.lab.aurora.coil import MOUNT
from station.lab.aurora.simulated import TARGET_SERIAL
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.ideal_lab import IdealLab
from station.lab.loads import Load
from station.lab.simulated_bench import SimulatedBench


class Lab(Protocol):
    """What goes on at the other side of the devices."""

    trouble: str  #: why the true robot has stayed where it was; empty when it follows its stages

    @property
    def true_robot(self) -> Robot:
        """The robot as it really is."""
        ...

    def true_joints(self, positions: Array) -> Array:
        """Where the joints really are (n,) when the stages count `positions` (n,) [rad or m]."""
        ...

    def apply_load(self, load: Load, start: float) -> None:
        """Put a load on the tip whose time counts from `start` [s]."""
        ...

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Let these happen, instead of those that are on or to come; their time counts from `start` [s]."""
        ...

    def advance(self, now: float) -> Truth:
        """Let time pass until `now` [s]."""
        ...


class VirtualBench(NamedTuple):
    """A lab and the devices that lead to it."""

    lab: Lab
    devices: Devices


def virtual_bench(
    robot: RobotFile, config: LabConfig, seed: int, positions: Array, registration: Registration | None = None
) -> VirtualBench:
    """Stages homed, with the joints at `positions` (n,); nothing is connected yet. Everything random is from `seed`.

    The tracker is believed to stand at `registration`; where the lab's stands unless told otherwise.

    Raises:
        PoseError, NoSolution: the true robot cannot stand there.
    """
    if config.devices == "ideal":
        ideal = IdealLab(robot, config, seed, positions)
        return VirtualBench(ideal, ideal.devices)
    lab = SimulatedBench(robot, config, seed, positions, homed=True)
    return VirtualBench(lab, drivers(lab, registration or MOUNT))


def drivers(lab: SimulatedBench, registration: Registration = MOUNT) -> Devices:
    """Drivers on the other ends of the lab's wires in memory."""
    tracker = lab.config.tracker
    target = "" if lab.config.target is None else TARGET_SERIAL
    settings = AuroraSettings(
        target_serial=target,
        frame_rate=tracker.rate,
        latency=tracker.latency,
        tells_axis=tracker.direction_noise is not None,
    )
    return Devices(
        ZaberStages(lab.setups, [Port(lab.hosts.zaber, tuple(range(len(lab.setups))))], reopen=_reopened),
        AuroraTracker(lab.hosts.aurora, settings, registration, reopen),
        NetftSensors(lab.hosts.netft, [read_page(box.page() or b"") for box in lab.boxes]),
    )


def _reopened(ports: Sequence[Port]) -> list[Port]:
    return [Port(reopen(port.link), port.stages) for port in ports]
