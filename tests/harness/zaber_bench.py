"""The paper's three Zaber stages as simulated units with their driver, in virtual time."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from station.config.robots import RobotFile
from station.devices.interfaces import Condition
from station.devices.kernel.stages import Port
from station.devices.links.link import Link
from station.devices.zaber.setup import StageSetup
from station.devices.zaber.stages import zaber_stages
from station.lab.simulated_line import pump
from station.lab.simulated_zaber import Unit, UnitKind, simulated_chain
from station.lab.wires import HostPort

TICK = 0.002
START = np.array([0.0, math.pi / 2, -0.100])
ROTARY = UnitKind(4421, None, 1_536_000)
LINEAR = UnitKind(4332, 604_724, serial=1001)
#: Size of a microstep of each stage [rad, rad, m]: 0.000234375 deg, 0.49609375 um.
STEPS = np.array([math.radians(0.000234375)] * 2 + [0.49609375e-6])


class Bench:
    """The paper's three Zaber stages on one serial line or on one line each, in virtual time."""

    def __init__(
        self,
        robot: RobotFile,
        at: Sequence[float] = tuple(START),
        homed: bool = True,
        apart: bool = False,
        seed: int = 0,
    ) -> None:
        numbers = (1, 1, 1) if apart else (1, 2, 3)
        self.setups = [StageSetup.of(joint, n) for joint, n in zip(robot.joints, numbers, strict=True)]
        self.home_at = np.array([setup.home_at for setup in self.setups])
        self.units: list[Unit] = []
        for setup, kind, q in zip(self.setups, (ROTARY, ROTARY, LINEAR), at, strict=True):
            place = (q - setup.home_at) / setup.joint.microstep
            self.units.append(Unit(kind, setup.device, place, place + setup.home_count if homed else None))
        groups = ((0,), (1,), (2,)) if apart else ((0, 1, 2),)
        self.chains = [simulated_chain([self.units[i] for i in group], seed) for group in groups]
        self.chain = self.chains[0]
        self.now = 0.0
        self.truth = self.places  #: joint positions at the last poll
        self.ports = self.plug(groups)
        self.stages = zaber_stages(self.setups, self.ports)
        self.order: list[int] = []  # units in the order in which they started homing

    def plug(self, groups: Sequence[tuple[int, ...]] = ((0, 1, 2),)) -> list[Port]:
        """Return new links, as if a serial adapter had been unplugged and plugged in again."""
        self.near = [HostPort(f"line {k}") for k in range(len(groups))]
        self.far: list[Link] = [host.device for host in self.near]
        return [Port(host, group) for host, group in zip(self.near, groups, strict=True)]

    def run(
        self,
        seconds: float,
        velocities: Callable[[float], Sequence[float]] | None = None,
        until: Callable[[], bool] = lambda: False,
    ) -> None:
        end = self.now + seconds
        while self.now < end and not until():
            self.reading, self.truth = self.stages.poll(self.now), self.places
            if velocities:
                self.stages.command(np.array(velocities(self.now)), self.now)
            self.let_go()

    def let_go(self) -> None:
        """Advance the simulated units by one tick."""
        for far, chain in zip(self.far, self.chains, strict=True):
            pump(far, chain, self.now + TICK, written=self.now)
        for i, unit in enumerate(self.units):
            if unit.status == 1 and i not in self.order:
                self.order.append(i)
        self.now += TICK

    def connect(self) -> "Bench":
        self.stages.connect(self.now)
        self.run(10.0, until=lambda: self.stages.condition is not Condition.CONNECTING)
        return self

    def home(self) -> None:
        self.stages.home(self.now)
        self.run(400.0, until=lambda: self.stages.condition is not Condition.HOMING)

    @property
    def places(self) -> np.ndarray:
        return self.home_at + STEPS * [unit.true_position for unit in self.units]

    @property
    def moving(self) -> list[bool]:
        return [unit.status != 0 for unit in self.units]


def connected(robot: RobotFile) -> Bench:
    """Return a bench whose driver has found and configured the units."""
    bench = Bench(robot).connect()
    assert bench.stages.condition is Condition.CONNECTED, bench.stages.problem
    return bench


def swing(now: float) -> list[float]:
    """Return swinging velocities of the three joints, up to 15 deg/s and 12 mm/s."""
    return [0.25 * math.sin(1.3 * now), 0.26 * math.cos(0.9 * now), 0.012 * math.sin(2.0 * now)]
