"""The kinds of simulated stages that a virtual lab can have, with the drivers of a real bench for them."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from station.config.robots import JointFile
from station.control.clock import StationClock
from station.devices.cia402.setup import DriveFile, DriveSetup
from station.devices.cia402.stages import cia402_stages
from station.devices.gcode.protocol import Dialect
from station.devices.gcode.setup import LETTERS, AxisSetup, GcodeAxisFile
from station.devices.gcode.stages import gcode_stages
from station.devices.interfaces import Stages
from station.devices.links.link import Link
from station.devices.zaber.setup import PortSetup, StageSetup
from station.devices.zaber.stages import ZaberStages
from station.devices.zaber_ascii.setup import AsciiSetup, AsciiStageFile
from station.devices.zaber_ascii.stages import ascii_stages
from station.lab.config import StagesKind
from station.lab.simulated_cia402 import SimulatedCanBus, SimulatedDrive
from station.lab.simulated_gcode import SimulatedBoard
from station.lab.simulated_zaber import Faults, LineNoise, SimulatedChain
from station.lab.simulated_zaber_ascii import AsciiUnit, SimulatedAsciiChain
from station.lab.zaber_unit import Unit, UnitKind


class SimulatedUnit(Protocol):
    """One simulated stage."""

    @property
    def true_position(self) -> float:
        """True position of the stage from the home sensor's zero [microsteps]."""
        ...


class SimulatedStages(Protocol):
    """The simulated stages of a bench on their line; a slot is a stage's number, counted from 1."""

    @property
    def faults(self) -> Faults:
        """Active faults of the stages and their line."""
        ...

    @faults.setter
    def faults(self, faults: Faults) -> None: ...

    @property
    def units(self) -> Sequence[SimulatedUnit]:
        """The stages in the robot's order."""
        ...

    @property
    def noise(self) -> LineNoise:
        """The damage that the line does to the bytes of both directions."""
        ...

    def receive(self, data: bytes, now: float) -> None:
        """Receive the bytes that the host has written until `now` [s]."""
        ...

    def advance(self, now: float) -> bytes:
        """Advance the simulation, and return the bytes that reach the host until `now` [s]."""
        ...

    def power_cycle(self, slot: int) -> None:
        """Switch one stage off and on."""
        ...


class StagesInLab(NamedTuple):
    """One kind of stages: the simulated devices, and their driver."""

    #: Returns the devices of the stages at true positions [microsteps], homed or just switched on, with a seed.
    simulate: Callable[[Sequence[StageSetup], Sequence[float], bool, int], SimulatedStages]
    #: Returns the driver at the host's end of the line.
    driver: Callable[[Sequence[StageSetup], Link], Stages]
    #: Returns `[devices.stages]` for the driver at the endpoint of the line, with the timeouts of the clock.
    table: Callable[[str, StationClock], Mapping[str, object]]


#: Device IDs of the simulated rotation and translation stages of the T-series; those of the real stages are unknown.
ROTARY_ID, LINEAR_ID = 4421, 4332
FIRST_SERIAL_NUMBER = 1000  #: a simulated stage of the T-series has this serial number plus its device number


def _zaber_unit(setup: StageSetup, true_position: float, homed: bool) -> Unit:
    """Return the unit of a stage at `true_position` from its home sensor's zero [microsteps]."""
    serial = FIRST_SERIAL_NUMBER + setup.device
    if setup.joint.motion == "rotation":
        kind = UnitKind(ROTARY_ID, None, round(2.0 * np.pi / setup.joint.microstep), serial=serial)
    else:
        kind = UnitKind(LINEAR_ID, setup.maximum, serial=serial)
    return Unit(kind, setup.device, true_position, true_position + setup.home_count if homed else None)


def _zaber(setups: Sequence[StageSetup], true_positions: Sequence[float], homed: bool, seed: int) -> SimulatedStages:
    return SimulatedChain([_zaber_unit(s, at, homed) for s, at in zip(setups, true_positions, strict=True)], seed)


def _ascii(setups: Sequence[StageSetup], true_positions: Sequence[float], homed: bool, seed: int) -> SimulatedStages:
    return SimulatedAsciiChain([AsciiUnit(s, at, homed) for s, at in zip(setups, true_positions, strict=True)], seed)


def _ascii_setup(joint: JointFile, device: int) -> AsciiSetup:
    return AsciiSetup.of(joint, AsciiStageFile(device=device))


def _cia402(setups: Sequence[StageSetup], true_positions: Sequence[float], homed: bool, seed: int) -> SimulatedStages:
    return SimulatedCanBus([SimulatedDrive(s, at, homed) for s, at in zip(setups, true_positions, strict=True)], seed)


def _board(dialect: Dialect) -> StagesInLab:
    """Return a G-code board and its driver."""

    def setups_of(setups: Sequence[StageSetup]) -> list[AxisSetup]:
        pairs = zip(setups, LETTERS, strict=False)
        return [AxisSetup.of(setup.joint, GcodeAxisFile(letter=letter)) for setup, letter in pairs]

    return StagesInLab(
        lambda setups, at, homed, seed: SimulatedBoard(dialect, setups, at, homed, seed),
        lambda setups, link: gcode_stages(setups_of(setups), link, dialect),
        lambda port, clock: {"driver": "gcode", "dialect": dialect, "port": port, "deadline": clock.patience},
    )


STAGES: Mapping[StagesKind, StagesInLab] = {
    "zaber": StagesInLab(
        _zaber,
        lambda setups, link: ZaberStages(setups, [PortSetup(link, tuple(range(len(setups))))]),
        lambda port, clock: {"driver": "zaber", "port": port, "deadline": clock.patience},
    ),
    "zaber_ascii": StagesInLab(
        _ascii,
        lambda setups, link: ascii_stages([_ascii_setup(s.joint, s.device) for s in setups], link),
        lambda port, clock: {"driver": "zaber_ascii", "port": port, "deadline": clock.patience},
    ),
    "cia402": StagesInLab(
        _cia402,
        lambda setups, link: cia402_stages([DriveSetup.of(s.joint, DriveFile(node=s.device)) for s in setups], link),
        lambda port, clock: {"driver": "cia402", "port": port, "deadline": clock.patience},
    ),
    "grbl": _board("grbl"),
    "marlin": _board("marlin"),
}
