"""The lab without flaw: what it is told it does, what is there it shows."""

import math

import numpy as np
import pytest

from station.experiments.experiment import offered
from station.lab.config import LabConfig, PlantConfig
from station.lab.ideal_lab import IdealLab
from station.lab.loads import ConstantLoad

START = np.array([0.0, math.pi / 2, -0.100])


@pytest.fixture
def lab(paper):
    return IdealLab(paper, LabConfig(devices="ideal", plant=PlantConfig(play={})), 0, START)


def test_a_load_pulls_from_its_start_on_and_moves_the_tip(lab):
    lab.apply_load(ConstantLoad(magnitude=0.5), start=0.010)
    before, at = lab.advance(0.008), lab.advance(0.010)

    assert not before.force.any()
    assert at.force == pytest.approx([0.5, 0.0, 0.0])
    # gravity points along +x; the compliance there is some 30 mm/N
    assert at.tip[0] - before.tip[0] == pytest.approx(0.015, rel=0.3)


def test_the_stages_run_as_told_from_the_moment_they_are_told(lab):
    lab.devices.stages.command(np.array([0.1, -0.2, 0.005]), 0.0)
    lab.advance(0.5)

    reading = lab.devices.stages.poll(0.5)
    assert reading.positions - START == pytest.approx([0.05, -0.1, 0.0025])
    assert reading.sent == pytest.approx([0.1, -0.2, 0.005])


def test_no_joint_is_faster_than_it_can_be_nor_leaves_its_travel(lab, paper):
    lab.devices.stages.command(np.array([9.0, 0.0, 9.0]), 0.0)
    lab.advance(1.0)
    assert lab.devices.stages.poll(1.0).positions[0] == pytest.approx(math.radians(20.0))
    lab.advance(10.0)
    assert lab.devices.stages.poll(10.0).positions[2] == paper.joints[2].upper


def test_a_stop_stops_at_once(lab):
    lab.devices.stages.command(np.array([0.1, 0.1, 0.0]), 0.0)
    lab.advance(0.1)
    lab.devices.stages.stop(0.1)
    lab.advance(0.2)

    assert lab.devices.stages.poll(0.2).positions[:2] - START[:2] == pytest.approx([0.01, 0.01])


def test_the_tracker_shows_the_true_tip_forty_times_a_second(lab):
    seen = []
    for tick in range(500):
        truth = lab.advance(0.002 * tick)
        if (frame := lab.devices.tracker.poll(0.002 * tick)) is not None:
            assert np.array_equal(frame.position, truth.tip)
            seen.append(frame.frame)

    assert seen == list(range(40))


def test_the_bases_feel_the_load_and_nothing_else(lab):
    rest = lab.devices.sensors.poll(0.0).wrenches.copy()
    lab.apply_load(ConstantLoad(magnitude=0.5, direction=(0.0, 0.0, 1.0)), start=0.0)
    lab.advance(0.0)
    lab.devices.stages.stop(0.0)

    felt = lab.devices.sensors.poll(0.0).wrenches - rest
    assert felt[:, 2].sum() == pytest.approx(0.5, abs=1e-3)  # both sensors' z is the world's


def test_the_paper_s_simulations_use_it_and_the_benches_do_not():
    labs = {name: {case.lab.devices for case in offered(name).cases} for name in ("fig3", "fig4", "fig7", "fig8")}

    assert labs == {"fig3": {"ideal"}, "fig4": {"ideal"}, "fig7": {"wire"}, "fig8": {"wire"}}
