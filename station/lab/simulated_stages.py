"""The kinds of simulated stages that a virtual lab can have, with the drivers of a real bench for them."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from station.config.controllers import StagesLatency
from station.config.robots import RobotFile
from station.control.clock import REAL_TIME_CLOCK, StationClock
from station.devices.gcode.protocol import Dialect
from station.devices.interfaces import Stages
from station.devices.kernel.driver import StagesDriver
from station.devices.links.link import Link
from station.devices.registry import STAGES_DRIVERS, stages_latency
from station.devices.zaber.setup import StageSetup
from station.lab.config import StagesKind
from station.lab.gcode_variants import VARIANTS
from station.lab.simulated_cia402 import DRIVE_VARIANTS, SimulatedDrive, simulated_can_bus
from station.lab.simulated_gcode import SimulatedBoard
from station.lab.simulated_line import AxisT, SimulatedStages
from station.lab.simulated_zaber import simulated_chain, unit_of
from station.lab.simulated_zaber_ascii import AsciiUnit, simulated_ascii_chain

#: Function that returns simulated stages. Its arguments: setups, true positions [microsteps], whether the stages are
#: homed, seed, name of the variant.
Simulate = Callable[[Sequence[StageSetup], Sequence[float], bool, int, str], SimulatedStages]


class StagesInLab(NamedTuple):
    """One kind of stages: the simulated devices, and their driver with its options."""

    simulate: Simulate
    name: str  #: name of the driver
    driver: StagesDriver
    options: Mapping[str, object] = MappingProxyType({})

    def table(self, port: str, clock: StationClock) -> Mapping[str, object]:
        """Return `[devices.stages]` for the driver at the endpoint of the line, with the timeouts of the clock."""
        return {"driver": self.name, **self.options, "port": port, "deadline": clock.patience}

    def on(self, link: Link, robot: RobotFile) -> Stages:
        """Return the driver at the host's end of the line."""
        return self.driver.on_link({**self.options, "port": link.name}, robot, link)


def simulated_stages(
    robot: RobotFile, kind: StagesInLab, positions: Sequence[float], homed: bool, seed: int, variant: str
) -> tuple[tuple[StageSetup, ...], SimulatedStages]:
    """Return one stage for each joint at true `positions` (n,) [rad or m], numbered in the robot file's order."""
    setups = tuple(StageSetup.of(joint, number) for number, joint in enumerate(robot.joints, 1))
    counts = [(q - setup.home_at) / setup.joint.microstep for q, setup in zip(positions, setups, strict=True)]
    return setups, kind.simulate(setups, counts, homed, seed, variant)


def on_line(
    unit: Callable[[StageSetup, float, bool, str], AxisT], line: Callable[[Sequence[AxisT], int], SimulatedStages]
) -> Simulate:
    """Return a function that simulates stages on a line: `unit` creates a stage's controller, `line` their line."""
    return lambda setups, positions, homed, seed, variant: line(
        [unit(setup, at, homed, variant) for setup, at in zip(setups, positions, strict=True)], seed
    )


def _board(dialect: Dialect) -> StagesInLab:
    """Return a G-code board and its driver."""
    return StagesInLab(
        lambda setups, at, homed, seed, name: SimulatedBoard(dialect, setups, at, homed, seed, VARIANTS[name]),
        "gcode",
        STAGES_DRIVERS["gcode"],
        {"dialect": dialect},
    )


def _driver(name: str, simulate: Simulate) -> StagesInLab:
    return StagesInLab(simulate, name, STAGES_DRIVERS[name])


STAGES: Mapping[StagesKind, StagesInLab] = {
    "zaber": _driver("zaber", on_line(lambda setup, at, homed, _: unit_of(setup, at, homed), simulated_chain)),
    "zaber_ascii": _driver(
        "zaber_ascii", on_line(lambda setup, at, homed, _: AsciiUnit(setup, at, homed), simulated_ascii_chain)
    ),
    "cia402": _driver(
        "cia402",
        on_line(lambda s, at, homed, name: SimulatedDrive(s, at, homed, DRIVE_VARIANTS[name]), simulated_can_bus),
    ),
    "grbl": _board("grbl"),
    "marlin": _board("marlin"),
}


def lab_latency(kind: StagesKind, robot: RobotFile) -> StagesLatency:
    """Return the latency of a virtual lab's stages, as their driver computes it for a real bench.

    Raises:
        ConfigError: the driver cannot move all joints of the robot.
    """
    return stages_latency(STAGES[kind].table("virtual lab", REAL_TIME_CLOCK), robot)
