"""A simulated bench in virtual time: the plant, its simulated devices, and the drivers that a real bench uses."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from core.robot.robot import Array, Robot
from station.config.robots import RobotFile
from station.devices.aurora.settings import AuroraSettings
from station.devices.aurora.tracker import AuroraTracker, TrackerMounting
from station.devices.interfaces import Devices, GroundTruth
from station.devices.links.link import reopen
from station.devices.netft.page import read_page
from station.devices.netft.sensors import NetftSensors
from station.devices.zaber.setup import PortSetup
from station.devices.zaber.stages import ZaberStages
from station.lab.aurora.coil import GENERATOR_POSE
from station.lab.aurora.simulated import TARGET_SERIAL
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.ideal_lab import IdealLab
from station.lab.loads import Load
from station.lab.simulated_bench import SimulatedBench


class Lab(Protocol):
    """The simulated world behind the devices."""

    trouble: str  #: reason why the plant cannot follow its stages; empty if it follows

    @property
    def true_robot(self) -> Robot:
        """The robot with its true parameters."""
        ...

    def true_joints(self, positions: Array) -> Array:
        """Return the true joints (n,) when the stages count `positions` (n,) [rad or m]."""
        ...

    def apply_load(self, load: Load, start: float) -> None:
        """Apply a load to the tip; its time counts from `start` [s]."""
        ...

    def inject(self, faults: Sequence[LabFault], start: float) -> None:
        """Replace all active and planned faults; times count from `start` [s]."""
        ...

    def advance(self, now: float) -> GroundTruth:
        """Advance the simulation until `now` [s]."""
        ...


class VirtualBench(NamedTuple):
    """A lab and the drivers of its devices."""

    lab: Lab
    devices: Devices


def virtual_bench(
    robot: RobotFile, config: LabConfig, seed: int, positions: Array, registration: TrackerMounting | None = None
) -> VirtualBench:
    """Return a bench with homed stages and the joints at `positions` (n,); nothing is connected yet.

    `seed` determines everything random. `registration` is the pose of the tracker that the driver assumes; by default
    it is the nominal pose in the lab.

    Raises:
        PoseError, NoSolution: the plant (simulated real robot) has no shape there.
    """
    if config.devices == "ideal":
        ideal = IdealLab(robot, config, seed, positions)
        return VirtualBench(ideal, ideal.devices)
    lab = SimulatedBench(robot, config, seed, positions, homed=True)
    return VirtualBench(lab, drivers(lab, registration or GENERATOR_POSE))


def drivers(lab: SimulatedBench, registration: TrackerMounting = GENERATOR_POSE) -> Devices:
    """Return drivers at the host ends of the lab's wires in memory."""
    tracker = lab.config.tracker
    target = "" if lab.config.target is None else TARGET_SERIAL
    settings = AuroraSettings(
        target_serial=target,
        frame_rate=tracker.rate,
        latency=tracker.latency,
        measures_axis=tracker.direction_noise is not None,
    )
    return Devices(
        ZaberStages(lab.setups, [PortSetup(lab.hosts.zaber, tuple(range(len(lab.setups))))], reopen=_reopened),
        AuroraTracker(lab.hosts.aurora, settings, registration, reopen),
        NetftSensors(lab.hosts.netft, [read_page(box.page() or b"") for box in lab.boxes]),
    )


def _reopened(ports: Sequence[PortSetup]) -> list[PortSetup]:
    return [PortSetup(reopen(port.link), port.stages) for port in ports]
