"""Latency that each driver of stages gives, compared with its simulated stages in virtual time.

Every axis gets a new velocity at random ticks. The lead time is the lag of the true motors behind the commanded motion:
a motor that executes v(t) later by L is behind by L v(t). The interval is counted on the wire.
"""

import re
from collections.abc import Iterator

import numpy as np
import pytest

from station.config.controllers import PERIOD_S, StagesLatency
from station.config.robots import RobotFile, load_robot
from station.devices.registry import stages_latency
from station.devices.zaber.backlog import MIN_BACKLOG_S
from station.lab.config import StagesKind
from station.lab.simulated_stages import STAGES, lab_latency
from tests.harness import zaber_bench
from tests.harness.stages_bench import StagesBench

SECONDS = 6.0
#: Velocities of one axis on the wire of each kind; a line of a board moves all axes.
VELOCITY = {
    "zaber": rb"[\xc0-\xc5]\x16....", "zaber_ascii": rb"move vel", "cia402": rb"t20[1-6]6", "grbl": rb"\$J=",
    "marlin": rb"G1",
}  # fmt: skip
#: Commands come at ticks, and a message leaves at a tick, so a lead time has a meaning only up to a tick [s].
LEAD_TOLERANCE = PERIOD_S
#: The length of a text depends on its number, and the number of queries of a stage on the delay of the replies.
INTERVAL_TOLERANCE = 0.2


class Ear:
    """Keeps the bytes that reach simulated devices."""

    def __init__(self, device) -> None:
        self.device, self.heard = device, b""

    def receive(self, data: bytes, now: float) -> None:
        self.heard += data
        self.device.receive(data, now)

    def __getattr__(self, name: str):
        return getattr(self.device, name)


def random_velocities(robot: RobotFile) -> Iterator[np.ndarray]:
    """Yield velocities that change at random ticks, far more slowly than the motors accelerate."""
    draw = np.random.default_rng(3)
    count = len(robot.joints)
    speeds = np.array([0.0125 * joint.acceleration for joint in robot.joints])
    rates, phases = draw.uniform(0.4, 1.2, (count, 3)), draw.uniform(0.0, 6.28, (count, 3))
    velocities, tick = np.zeros(count), 0
    while True:
        now = speeds * np.sin(2.0 * np.pi * rates * tick * PERIOD_S + phases).sum(axis=1)
        velocities = np.where(draw.uniform(size=count) < 0.7, now, velocities)
        tick += 1
        yield velocities


def lead_times(bench, robot: RobotFile) -> np.ndarray:
    """Return the lag of each true motor behind its commands [s]."""
    rows, source = [], random_velocities(robot)

    def command(now: float) -> np.ndarray:
        velocities = next(source)
        rows.append((velocities, bench.truth))
        return velocities

    bench.run(SECONDS, command)
    commanded, true = np.array(rows)[50:].transpose(1, 0, 2)
    behind = np.cumsum(commanded, axis=0) * PERIOD_S - PERIOD_S * commanded - true
    behind, moving = behind - behind.mean(axis=0), commanded - commanded.mean(axis=0)
    return (behind * moving).sum(axis=0) / (moving**2).sum(axis=0)


def assert_fits(given: StagesLatency, leads: np.ndarray, interval: float, backlog: float = 0.0) -> None:
    assert given.interval == pytest.approx(interval, rel=INTERVAL_TOLERANCE)
    assert given.delay + 0.5 * given.interval - backlog == pytest.approx(leads.mean(), abs=LEAD_TOLERANCE)


@pytest.mark.parametrize("name", ["paper", "three_tubes"])
@pytest.mark.parametrize("kind", list(STAGES))
def test_simulated_stages_have_the_latency_that_their_driver_gives(kind: StagesKind, name: str):
    robot = load_robot(name)
    middle = [0.3 if j.motion == "rotation" else 0.5 * (j.lower + j.upper) for j in robot.joints]
    bench = StagesBench(robot, kind, middle).connect()
    assert bench.stages.ready, bench.cause
    bench.simulated = ear = Ear(bench.simulated)
    leads = lead_times(bench, robot)
    sent = len(re.findall(VELOCITY[kind], ear.heard, re.DOTALL))
    axes = 1 if kind in ("grbl", "marlin") else len(robot.joints)
    # A simulated line has no backlog, which the number of a chain of T-series stages contains.
    assert_fits(lab_latency(kind, robot), leads, SECONDS * axes / sent, MIN_BACKLOG_S if kind == "zaber" else 0.0)


def test_zaber_stages_on_separate_ports_have_the_latency_that_their_driver_gives(paper):
    bench = zaber_bench.Bench(paper, apart=True).connect()
    bench.chains[:] = ears = [Ear(chain) for chain in bench.chains]
    leads = lead_times(bench, paper)
    sent = sum(len(re.findall(VELOCITY["zaber"], ear.heard, re.DOTALL)) for ear in ears)
    joints = {joint.name: {"port": f"line {i}", "device": 1} for i, joint in enumerate(paper.joints)}
    given = stages_latency({"driver": "zaber", "joints": joints}, paper)
    assert given == StagesLatency(0.010, 0.006)
    assert_fits(given, leads, SECONDS * 3 / sent)
