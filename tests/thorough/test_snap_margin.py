"""Twenty robots of three tubes stop before they snap, and no experiment of the presets ends by a false alarm."""

from itertools import product

import numpy as np
import pytest

from core.model.statics import Statics
from core.model.uniqueness import is_unique
from core.robot.robot import Array, Robot
from station.config.robots import RobotFile
from station.config.strict import preset_names
from station.control.monitors import Margins
from station.control.states import State
from station.experiments.experiment import Case, offered_experiment
from station.lab.config import TubeError
from station.lab.plant import true_robot
from tests.harness.cases import a_run
from tests.harness.virtual_station import VirtualStation, usual_case
from tests.virtual.faults.test_snapping import MOVES_M, largest_step, steep

CASES = [case for name in preset_names("experiments") for case in offered_experiment(name).cases]
#: Number of positions of each translation, from the lower to the upper end of its travel.
POSITIONS = 9


def cannot_snap(robot: RobotFile) -> bool:
    """Return whether tubes that differ by the margins' uncertainty have one shape under every permitted force."""
    tubes, limits, uncertainty = robot.robot(), robot.limits().packed, Margins().uncertainty
    more_curved = tubes.layout._replace(curvatures=(1.0 + 2.0 * uncertainty) * tubes.layout.curvatures)
    force = robot.largest_force().newton / (1.0 - uncertainty)
    travels = [
        np.linspace(lower, upper, POSITIONS) if joint.motion == "translation" else np.zeros(1)
        for joint, lower, upper in zip(robot.joints, *limits[:2], strict=True)
    ]
    poses = [pose for at in product(*travels) if tubes.is_valid_pose(pose := np.array(at))]
    ones = (0.0,) * len(tubes.tubes)
    return all(is_unique(more_curved, tubes.tube_poses(pose)[1], force, np.inf, ones) for pose in poses)


def test_tubes_of_the_paper_cannot_snap_in_any_experiment() -> None:
    (paper,) = {case.robot.name: case.robot for case in CASES if case.robot.name == "paper"}.values()
    assert cannot_snap(paper)


@pytest.mark.parametrize("case", [case for case in CASES if case.robot.name != "paper"], ids=lambda case: case.name)
def test_experiment_whose_tubes_could_snap_ends_without_an_alarm(case: Case) -> None:
    run = a_run(case)
    assert run.completed, run.cause


#: Start with the inner and the outer tube 3 rad apart; both turn away from each other at full speed.
START = np.array([-1.5, 0.0, 1.5, -0.10, -0.19, -0.28])
APART = np.array([-1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
#: Time for which the jog lasts if nothing ends it [s], and ticks between two renewals.
JOG_S, RENEWAL_TICKS = 12.0, 50
#: Step of the rotations [rad], and smallest distance by which the tip jumps in a snap [m].
STEP_RAD, JUMP_M = 0.005, 0.010


def jumps(robot: Robot, travel: float) -> bool:
    """Return whether the tip jumps while the tubes turn apart by `travel` on each side [rad]."""
    model, none = Statics(robot), np.zeros(6)
    at = model.solve(START, none)
    for turn in np.arange(STEP_RAD, travel, STEP_RAD):
        after = model.solve(START + turn * APART, none, at)
        if np.linalg.norm(after.tip - at.tip) > JUMP_M:
            return True
        at = after
    return False


@pytest.mark.parametrize("seed", range(20))
def test_three_tubes_that_differ_by_five_percent_are_stopped_before_they_snap(seed: int) -> None:
    signs = np.random.default_rng(seed).choice([-0.05, 0.05], (3, 2)).tolist()
    robot, case = steep(2.4 + 0.05 * (seed % 4), "three_tubes"), usual_case()
    errors = {
        tube.name: TubeError(stiffness=stiffness, curvature=curvature)
        for tube, (stiffness, curvature) in zip(robot.tubes, signs, strict=True)
    }
    plant = case.lab.plant.model_copy(update={"tubes": errors, "play": {}})
    case = case._replace(
        robot=robot, lab=case.lab.model_copy(update={"plant": plant}),
        controller=case.file.controller.controller(robot), start=START,
    )  # fmt: skip
    speed: Array = APART * [joint.speed for joint in robot.joints]
    assert jumps(true_robot(robot.robot(), plant, np.random.default_rng(0)), speed.max() * JOG_S)

    station = VirtualStation(case, Margins(apart=0.5)).ready()
    station.loop.jog(station.now, "joints", speed)
    for _ in range(round(JOG_S / 0.002 / RENEWAL_TICKS)):
        station.tick(RENEWAL_TICKS)
        if station.state is not State.RUNNING:
            break
        station.loop.jog(station.now, "joints", speed)
    assert station.state is State.HOLD
    station.seconds(0.5)

    assert "the tubes are about to snap: tubes that differ by 5 %" in station.loop.cause
    assert largest_step(station) < MOVES_M
    assert station.rests()
