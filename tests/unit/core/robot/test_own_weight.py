"""The tip force that represents the tubes' own weight matches a textbook beam and the exact rod."""

from dataclasses import replace

import numpy as np
import pytest

from core.model.statics import Statics
from core.robot.own_weight import own_weight
from core.robot.robot import Section
from station.config.robots import load_robot
from station.lab.config import PlantConfig, load_lab
from station.lab.frictional_plant import FrictionalPlant


def test_the_equivalent_tip_force_of_a_single_tube_is_three_eighths_of_its_weight(one_tube):
    robot = one_tube(Section(0.2))
    heavy = replace(robot, tubes=(replace(robot.tubes[0], weight=0.3),))

    assert own_weight(heavy, np.zeros(2)) == pytest.approx(3 / 8 * 0.3 * 0.2)
    assert own_weight(robot, np.zeros(2)) == 0.0


@pytest.mark.parametrize("joints", [(0.0, 1.57, -0.1), (1.0, -0.5, -0.02), (2.5, 3.0, -0.06), (-1.5, -1.2, -0.12)])
def test_the_equivalent_tip_force_bends_the_papers_robot_like_its_weight(joints):
    """The tip error is a tenth of the sag, at most 0.05 mm; without the equivalent force it is 0.2 to 0.6 mm."""
    file, pose = load_robot("paper"), np.array(joints)
    robot = file.robot()
    rough: PlantConfig = load_lab("realistic", file).plant.model_copy(
        update={"friction": 0.0, "clearance": 0.0, "walk": 0.0, "tubes": {}, "poisson_ratio": None, "play": {}}
    )
    tips = []
    for plant in (rough, rough.model_copy(update={"density": 0.0})):
        rod = FrictionalPlant(robot, plant, np.random.default_rng(0), pose)
        tips.append(rod.advance(pose, np.zeros(3)).truth.tip)
    sag, model = tips[0] - tips[1], Statics(robot)

    pulled = model.solve(pose, np.array([own_weight(robot, pose), 0.0, 0.0, 0.0, 0.0, 0.0])).tip
    found = pulled - model.solve(pose, np.zeros(6)).tip

    assert np.linalg.norm(found - sag) < 0.1 * np.linalg.norm(sag)
