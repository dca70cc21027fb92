"""The ideal lab executes commands exactly and measures exactly."""

import math

import numpy as np
import pytest

from station.config.loads import ConstantLoad
from station.config.strict import ConfigError
from station.experiments.experiment import offered_experiment
from station.lab.config import LabConfig, PlantConfig
from station.lab.faults import LabFault
from station.lab.virtual_bench import IdealLab

START = np.array([0.0, math.pi / 2, -0.100])


@pytest.fixture
def lab(paper):
    return IdealLab(paper, LabConfig(devices="ideal", plant=PlantConfig(play={})), 0, START)


def test_load_in_the_ideal_lab_acts_from_its_start_and_moves_the_tip(lab):
    lab.apply_load(ConstantLoad(magnitude=0.5), start=0.010)
    before, at = lab.advance(0.008), lab.advance(0.010)

    assert not before.force.any()
    assert at.force == pytest.approx([0.5, 0.0, 0.0])
    # The load points along +x, where the compliance of the tip is about 30 mm/N.
    assert at.tip[0] - before.tip[0] == pytest.approx(0.015, rel=0.3)


def test_ideal_stages_keep_speed_limits_and_travel(lab, paper):
    lab.devices.stages.command(np.array([9.0, 0.0, 9.0]), 0.0)
    lab.advance(1.0)
    assert lab.devices.stages.poll(1.0).positions[0] == pytest.approx(math.radians(20.0))
    lab.advance(10.0)
    assert lab.devices.stages.poll(10.0).positions[2] == paper.joints[2].upper


def test_stop_halts_ideal_stages_at_once(lab):
    lab.devices.stages.command(np.array([0.1, 0.1, 0.0]), 0.0)
    lab.advance(0.1)
    lab.devices.stages.stop(0.1)
    lab.advance(0.2)

    assert lab.devices.stages.poll(0.2).positions[:2] - START[:2] == pytest.approx([0.01, 0.01])


def test_ideal_tracker_reports_the_true_tip_forty_times_a_second(lab):
    seen = []
    for tick in range(500):
        truth = lab.advance(0.002 * tick)
        if (frame := lab.devices.tracker.poll(0.002 * tick)) is not None:
            assert np.array_equal(frame.position, truth.tip)
            seen.append(frame.frame)

    assert seen == list(range(40))


def test_ideal_base_sensors_measure_the_load_only(lab):
    rest = lab.devices.sensors.poll(0.0).wrenches.copy()
    lab.apply_load(ConstantLoad(magnitude=0.5, direction=(0.0, 0.0, 1.0)), start=0.0)
    lab.advance(0.0)
    lab.devices.stages.stop(0.0)

    felt = lab.devices.sensors.poll(0.0).wrenches - rest
    assert felt[:, 2].sum() == pytest.approx(0.5, abs=1e-3)  # z of both sensors is z of the world


def test_preset_experiments_use_the_ideal_lab_only_for_the_papers_simulations():
    labs = {name: {case.lab.devices for case in offered_experiment(name).cases} for name in ("fig3", "fig7")}
    assert labs == {"fig3": {"ideal"}, "fig7": {"wire"}}


def test_ideal_devices_refuse_faults_and_say_which_lab_has_them(lab):
    with pytest.raises(ConfigError, match="devices = 'wire'"):
        lab.inject([LabFault(kind="disconnect", device="tracker")], 0.0)
    lab.inject([], 0.0)
