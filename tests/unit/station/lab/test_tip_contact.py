"""The contact of the tip with obstacles is checked against springs in series, and against the laws of the obstacles."""

import math

import numpy as np
import pytest

from station.config.loads import ConstantLoad, SphereLoad, WallLoad, elastic_force
from station.config.robots import load_robot
from station.lab.config import PlantConfig, load_lab
from station.lab.frictional_plant import true_plant
from station.lab.tip_contact import LoadedPlant

ROBOT = load_robot("paper")
START = np.array([0.0, 0.5 * math.pi, -0.1])
SMOOTH = PlantConfig()
ROUGH = load_lab("realistic", ROBOT).plant
PERIOD = 0.002


def plant(config=SMOOTH):
    return true_plant(ROBOT.robot(), config, np.random.default_rng(1), START)


def natural_compliance(normal, newton=0.02):
    """Return the plant's compliance along `normal` [m/N], by central differences of its tip under known forces."""
    tips = [plant().advance(START, side * newton * np.array(normal)).truth.tip for side in (1.0, -1.0)]
    return float((tips[0] - tips[1]) @ normal) / (2.0 * newton)


@pytest.mark.parametrize(
    ("stiffness", "normal"), [(30.0, (1.0, 0.0, 0.0)), (1000.0, (0.0, -1.0, 0.0)), (1e5, (0.0, 0.0, -1.0))]
)
def test_wall_that_has_moved_into_the_tip_balances_the_tubes_as_a_spring_in_series(stiffness, normal):
    pressed = 1e-4
    loaded = LoadedPlant(plant())
    loaded.apply(WallLoad(direction=normal, distance=-pressed, stiffness=stiffness), 0.0)
    for tick in range(10):
        truth = loaded.advance(START, tick * PERIOD).truth
    expected = pressed / (1.0 / stiffness + natural_compliance(normal))
    assert truth.force @ normal == pytest.approx(expected, rel=0.01)
    assert truth.force == pytest.approx(expected * np.array(normal), rel=0.01, abs=1e-9)


@pytest.mark.parametrize("config", [SMOOTH, ROUGH], ids=["smooth", "rough"])
def test_force_of_every_tick_is_that_of_the_wall_at_the_true_tip_while_the_robot_pushes(config):
    loaded = LoadedPlant(plant(config))
    wall = WallLoad(direction=(0.0, 0.0, -1.0), distance=0.001, stiffness=1000.0)
    start = loaded.advance(START, 0.0).truth.tip
    loaded.apply(wall, 0.0)
    touched = 0
    for tick in range(200):
        truth = loaded.advance(START + np.array([0.0, 0.0, 1e-2 * tick * PERIOD]), tick * PERIOD).truth
        depth = float(truth.tip[2] - start[2]) - wall.distance
        assert truth.force == pytest.approx([0.0, 0.0, -1000.0 * max(depth, 0.0)], abs=2e-5)
        touched += depth > 0.0
    assert touched > 50


@pytest.mark.parametrize("stiffness", [100.0, 1e4])
def test_moving_damped_wall_follows_the_law_of_a_kelvin_voigt_solid(stiffness):
    wall = WallLoad(
        direction=(1.0, 0.0, 0.0), distance=-0.002, stiffness=stiffness, damping=20.0, amplitude=0.003, frequency=1.0
    )
    loaded = LoadedPlant(plant())
    start = loaded.advance(START, 0.0).truth.tip
    loaded.apply(wall, 0.0)
    depths, forces = [], []
    for tick in range(600):
        truth = loaded.advance(START, tick * PERIOD).truth
        depths.append(0.002 + wall.displacement(tick * PERIOD) - (truth.tip - start)[0])
        forces.append(truth.force[0])
    rates = np.diff(np.maximum(depths, 0.0)) / PERIOD
    law = np.where(np.array(depths[1:]) > 0.0, stiffness * np.array(depths[1:]) + 20.0 * rates, 0.0)
    assert np.array(forces[1:]) == pytest.approx(np.maximum(law, 0.0), abs=1e-3)
    assert (np.array(forces) == 0.0).any(), "the wall leaves the tip"


def test_friction_holds_the_tip_up_to_its_limit_and_then_lets_it_slide():
    wall = WallLoad(direction=(1.0, 0.0, 0.0), distance=-0.004, stiffness=500.0, friction=0.3)
    loaded = LoadedPlant(plant())
    loaded.apply(wall, 0.0)
    ratios = []
    for tick in range(500):
        force = loaded.advance(START + np.array([0.0, 0.0, 5e-3 * tick * PERIOD]), tick * PERIOD).truth.force
        ratios.append(math.hypot(*force[1:]) / force[0] if force[0] > 0.0 else 0.0)
    assert max(ratios) == pytest.approx(0.3, rel=1e-3)
    assert ratios[4] < 0.2, "the tip sticks before it slides"
    assert force[2] < 0.0, "friction opposes the motion along +z"


def test_sphere_pushes_the_tip_away_from_its_center():
    sphere = SphereLoad(center=(0.006, 0.0, 0.008), radius=0.012, stiffness=200.0)
    loaded = LoadedPlant(plant())
    start = loaded.advance(START, 0.0).truth.tip
    loaded.apply(sphere, 0.0)
    for tick in range(5):
        truth = loaded.advance(START, tick * PERIOD).truth
    away = truth.tip - start - sphere.center
    assert truth.force == pytest.approx(200.0 * (0.012 / np.linalg.norm(away) - 1.0) * away, abs=2e-5)


def test_tip_that_leaves_a_wall_is_free_of_force_at_once():
    loaded = LoadedPlant(plant())
    loaded.apply(WallLoad(direction=(0.0, 0.0, -1.0), distance=-0.001, stiffness=1e3), 0.0)
    for tick in range(5):
        pressed = loaded.advance(START, tick * PERIOD).truth
    free = loaded.advance(START - [0.0, 0.0, 0.01], 5 * PERIOD).truth
    assert pressed.force[2] < -0.05
    assert not free.force.any()


def test_obstacle_does_not_act_before_its_start():
    loaded = LoadedPlant(plant())
    loaded.apply(WallLoad(direction=(1.0, 0.0, 0.0), distance=-0.001), 1.0)
    assert not loaded.advance(START, 0.9).truth.force.any()
    loaded.advance(START, 1.0)
    assert loaded.advance(START, 1.002).truth.force[0] > 0.01


def test_load_that_does_not_depend_on_the_tip_acts_as_on_the_plant_itself():
    loaded, bare = LoadedPlant(plant()), plant()
    loaded.apply(ConstantLoad(magnitude=0.2), 0.0)
    assert (loaded.advance(START, 0.0).truth.tip == bare.advance(START, np.array([0.2, 0.0, 0.0])).truth.tip).all()


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_force_of_every_tick_on_a_lump_follows_from_its_energy_at_the_true_tip(friction):
    wall = WallLoad(
        direction=(0.0, 0.0, -1.0), distance=0.001, stiffness=150.0, friction=friction,
        lump_stiffness=250.0, lump_center=(0.002, 0.0, 0.0), lump_radius=0.004,
    )  # fmt: skip
    loaded = LoadedPlant(plant())
    start = loaded.advance(START, 0.0).truth.tip
    loaded.apply(wall, 0.0)
    loads, rubs = [], []
    for tick in range(400):
        truth = loaded.advance(START + np.array([0.0, 0.0, 5e-3 * tick * PERIOD]), tick * PERIOD).truth
        elastic = elastic_force(wall, truth.tip - start)
        loads.append(-truth.force[2])
        rubs.append(float(np.linalg.norm((truth.force - elastic)[:2])))
        assert truth.force[2] == pytest.approx(elastic[2], abs=2e-5)
    assert max(loads) > 0.1
    assert (np.array(rubs) <= friction * np.array(loads) + 2e-5).all()
    assert (max(rubs) > 1e-3) == (friction > 0.0)
