"""Counts of a stage's microsteps, for both mounting directions and any position of the home sensor."""

import math

import numpy as np
import pytest

from station.devices.interfaces import Condition
from station.devices.kernel.stages import Port
from station.devices.zaber.protocol import ZaberError
from station.devices.zaber.setup import StageSetup
from station.devices.zaber.stages import zaber_stages
from station.lab.simulated_line import pump
from station.lab.simulated_zaber import Unit, UnitKind, simulated_chain
from station.lab.wires import HostPort

MICROMETRE = 1e-6


def test_rotation_has_equal_travel_in_both_directions(paper):
    setup = StageSetup.of(paper.joints[0], 1)
    assert (setup.home_count, setup.maximum) == (1_536_000, 3_072_000)
    assert setup.position(0) == pytest.approx(-2.0 * math.pi)
    assert setup.position(3_072_000) == pytest.approx(2.0 * math.pi)


def test_zero_away_from_the_sensor_shifts_the_counts_but_not_the_travel(paper):
    setup = StageSetup.of(paper.joints[0], 1, home_at=math.radians(90.0))
    assert setup.position(setup.home_count) == pytest.approx(math.radians(90.0))
    assert setup.maximum == 3_072_000
    assert [setup.position(count) for count in (0, setup.maximum)] == pytest.approx([-2.0 * math.pi, 2.0 * math.pi])


def test_backwards_joint_decreases_while_the_count_increases(paper):
    turning, sliding = (StageSetup.of(paper.joints[i], 1, backwards=True) for i in (1, 2))
    assert [turning.position(c) for c in (0, turning.maximum)] == pytest.approx([2.0 * math.pi, -2.0 * math.pi])
    assert sliding.position(0) == pytest.approx(-0.005)  # its sensor is at the inserted end
    assert sliding.position(sliding.maximum) == pytest.approx(-0.130, abs=MICROMETRE)


def test_travel_is_reachable_with_a_home_sensor_outside_of_it(paper):
    setup = StageSetup.of(paper.joints[2], 1, home_at=-0.150)
    assert setup.position(0) == -0.150
    assert setup.position(setup.maximum) == pytest.approx(-0.005, abs=MICROMETRE)


@pytest.mark.parametrize(("home_at", "backwards"), [(-0.100, False), (-0.100, True)])
def test_home_sensor_inside_the_travel_is_refused_with_both_values(paper, home_at, backwards):
    with pytest.raises(ZaberError, match=r"inner_translation: home_at -0.1 m is inside the travel -0.13 ... -0.005 m"):
        StageSetup.of(paper.joints[2], 1, home_at, backwards)


def test_backwards_mounted_stage_homes_and_moves_in_the_right_direction(paper):
    """The simulated unit may count in any direction; the driver reports the true joint position."""
    joint = paper.joints[2]
    setup = StageSetup.of(joint, 1, backwards=True)
    unit = Unit(UnitKind(4332, setup.maximum), 1, 20_000.0)
    host = HostPort("line")
    device = host.device
    chain, stages, now = simulated_chain([unit]), zaber_stages([setup], [Port(host, (0,))]), 0.0

    def run(seconds: float, velocity: float | None = None) -> float:
        nonlocal now
        end = now + seconds
        while now < end:
            reading = stages.poll(now)
            if velocity is not None:
                stages.command(np.array([velocity]), now)
            pump(device, chain, now + 0.002, written=now)
            now += 0.002
        return float(reading.positions[0])

    stages.connect(now)
    run(3.0)
    stages.home(now)
    run(20.0)
    assert stages.condition is Condition.CONNECTED, stages.problem
    assert run(0.1) == pytest.approx(-0.005, abs=1e-8)
    run(1.0, -0.010)
    stages.stop(now)
    assert run(1.0) == pytest.approx(-0.015, abs=5e-4)
    assert -0.005 - unit.true_position * joint.microstep == pytest.approx(run(0.1), abs=1e-6)
