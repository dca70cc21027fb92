"""The virtual lab as a whole: its clock, its load, its seeds."""

import math

import numpy as np
import pytest

from station.lab.config import LabConfig, PlantConfig, TrackerConfig
from station.lab.loads import ConstantLoad
from station.lab.virtual_lab import VirtualLab

START = np.array([0.0, math.pi / 2, -0.100])


@pytest.fixture
def lab(paper):
    def make(seed: int = 0, **changes: object) -> VirtualLab:
        return VirtualLab(paper, LabConfig().model_copy(update=changes), seed, START)

    return make


def readings(lab: VirtualLab, ticks: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Frames and wrenches of the first ticks."""
    tips, wrenches = [], []
    for tick in range(ticks):
        lab.advance(0.002 * tick)
        if (frame := lab.devices.tracker.poll(0.002 * tick)) is not None:
            tips.append(frame.position)
        wrenches.append(lab.devices.sensors.poll(0.002 * tick).wrenches)
    return np.array(tips), np.array(wrenches)


def test_a_load_pulls_from_its_start_on_and_moves_the_tip(lab):
    one = lab()
    one.pull(ConstantLoad(magnitude=0.5), start=0.010)
    before, at, after = (one.advance(time) for time in (0.008, 0.010, 0.012))

    assert not before.force.any()
    assert at.force == pytest.approx([0.5, 0.0, 0.0])
    assert after.force == pytest.approx([0.5, 0.0, 0.0])
    # gravity points along +x; the compliance there is some 30 mm/N
    assert after.tip[0] - before.tip[0] == pytest.approx(0.015, rel=0.3)


def test_nothing_pulls_unless_told(lab):
    assert not lab().advance(5.0).force.any()


def test_the_stages_move_the_true_tip(lab):
    one = lab()
    start = one.advance(0.0).tip
    one.devices.stages.command(np.array([0.0, 0.0, 0.010]), 0.0)

    assert one.advance(1.0).tip[2] - start[2] > 0.005


def test_the_same_seed_gives_the_same_readings_and_another_seed_others(lab):
    first, again, other = (readings(lab(seed)) for seed in (7, 7, 8))

    for mine, same, different in zip(first, again, other, strict=True):
        assert np.array_equal(mine, same)
        assert not np.array_equal(mine, different)


def test_the_seed_draws_the_tubes_when_they_vary_and_only_then(lab):
    fixed = [lab(seed).truth.tip for seed in (1, 2)]
    varied = [lab(seed, plant=PlantConfig(vary=0.08)).truth.tip for seed in (1, 1, 2)]

    assert np.array_equal(fixed[0], fixed[1])
    assert np.array_equal(varied[0], varied[1])
    assert np.linalg.norm(varied[0] - varied[2]) > 1e-4


def test_another_tracker_does_not_change_what_the_sensors_draw(lab):
    usual, faster = readings(lab()), readings(lab(tracker=TrackerConfig(rate=80.0)))

    assert len(faster[0]) > len(usual[0])
    assert np.array_equal(usual[1], faster[1])
