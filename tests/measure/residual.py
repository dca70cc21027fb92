"""Poses for `validate`: a simulated robot of three tubes with strong friction, whose ends are often flush.

    python -m tests.measure.residual FOLDER [--seed 1]
    ctr-station validate FOLDER/robot.toml FOLDER/poses.csv --fit residual
    python -m tests.measure.residual --cost                # microseconds that a residual adds to a tick

The folder receives both files. Each of 20 trajectories moves the joints along 10 straight lines, with 4 poses on each.
The exact rod with curvatures 3 to 5 % off gives the true tips. Friction winds each tube up by Dahl's law. The tracker's
noise is 0.05 mm.
"""

import argparse
import csv
import re
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from core.calibration.quantities import quantities, with_changes
from core.calibration.residual import relative_rotations
from core.control.estimation import Actuation, Estimator, corrected
from core.control.observer import Observer, RateFilter
from core.control.tip_residual import MAX_SUPPORT, TipResidual, inputs_of
from core.model.cosserat import ExactRod
from core.model.statics import Statics
from station.config.robots import RobotFile, load_robot, named_pose
from station.config.strict import PRESETS

TRAJECTORIES, LINES, POSES, STEPS = 20, 10, 4, 10
#: Range of the rotations [rad], and share of the goals at which two neighbouring tubes end flush.
TURN_RAD, FLUSH_SHARE = 1.0, 0.5
#: Straight and curved length [m] and curvature [1/m] of the tubes, innermost first.
TUBES = ((0.25, 0.08, 12.0), (0.16, 0.06, 8.0), (0.08, 0.05, 5.0))
#: Relative error of each curvature, and largest wind-up of each tube [rad].
CURVATURE_ERRORS, HALF_LAGS = np.array([0.05, -0.04, 0.03]), np.array([0.3, 0.2, 0.0])


def robot_text() -> str:
    """Return the file of a robot with the joints of the preset `three_tubes` and shorter, more curved tubes."""
    sections = iter(
        f"sections = [{{ length = {straight} }}, {{ length = {curved}, curvature = [{bend}, 0.0] }}]"
        for straight, curved, bend in TUBES
    )
    text = (PRESETS / "robots" / "three_tubes.toml").read_text(encoding="utf-8")
    text = re.sub(r"^sections = .*$", lambda _: next(sections), text, flags=re.MULTILINE)
    text = re.sub(r"^working_pose = .*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"^lower = -0\..*$", "lower = -0.3", text, flags=re.MULTILINE)
    text = re.sub(r"^upper = -0\..*$", "upper = 0.0", text, flags=re.MULTILINE)
    return text.replace('name = "three_tubes"', 'name = "flush"')


def goals(file: RobotFile, random: np.random.Generator) -> Iterator[np.ndarray]:
    """Yield random valid joint positions; in a part of them two neighbouring tubes end flush."""
    robot = file.robot()
    lengths = [tube.length for tube in robot.tubes]
    while True:
        turns, slide = random.uniform(-TURN_RAD, TURN_RAD, 3), random.uniform(-0.06, -0.03)
        gaps = random.uniform(0.0, 0.03, 2) * (random.random(2) > FLUSH_SHARE)
        middle = slide + lengths[2] + gaps[0] - lengths[1]
        inner = middle + lengths[1] + gaps[1] - lengths[0]
        pose = np.array([*turns, slide, middle, inner])
        if robot.is_valid_pose(pose):
            yield pose


def cost(name: str, calls: int = 20_000) -> float:
    """Return the time [us] that a residual with the largest number of support points adds to a tick."""
    robot, random = load_robot(name).robot(), np.random.default_rng(1)
    inputs, m = inputs_of(robot), MAX_SUPPORT
    pose = named_pose(load_robot(name).working_pose, load_robot(name), "working_pose")
    support = random.normal(0.0, 1.0, (m, len(inputs.table)))
    scales, weights = np.full(len(inputs.table), 2.0), 1e-3 * random.standard_normal((m, 3))
    residual = TipResidual(inputs, np.eye(3), scales, support, weights, np.eye(m), 1.0, 1.0)
    solved = Statics(robot).solve(pose, np.zeros(6))
    estimator = Estimator(RateFilter(2e-3, 5.0), Observer(2e-3), Actuation(2e-3), residual=residual)
    now = estimator.start(solved, solved, np.zeros(3), solved.tip)
    loaded, free = solved.numbers.copy(), solved.numbers.copy()
    arguments = estimator.residual.packed(), 2e-3, loaded, free, solved.numbers, now.numbers, now.numbers.copy()
    corrected(*arguments)
    best = np.inf
    for _ in range(20):  # the best of them: other programs use the processors, too
        start = time.perf_counter()
        for _ in range(calls // 20):
            corrected(*arguments)
        best = min(best, time.perf_counter() - start)
    return 1e6 * best / (calls // 20)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.measure.residual", description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("flush"))
    parser.add_argument("--cost", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if given.cost:
        for name in ("paper", "three_tubes"):
            print(f"{name}: {cost(name):.1f} us")  # noqa: T201
        return
    given.folder.mkdir(parents=True, exist_ok=True)
    path = given.folder / "robot.toml"
    path.write_text(robot_text(), encoding="utf-8")
    random, file = np.random.default_rng(given.seed), load_robot(str(path))
    robot, ahead = file.robot(), goals(file, random)
    what = [quantity for quantity in quantities(robot) if quantity.kind == "curvature"]
    exact, at, wound = ExactRod(with_changes(robot, what, CURVATURE_ERRORS)), next(ahead), np.zeros(3)
    with (given.folder / "poses.csv").open("w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out)
        writer.writerow(["time", "trajectory", *robot.joint_names, "tip_x", "tip_y", "tip_z"])
        for number in range(TRAJECTORIES * LINES * POSES):
            if number % POSES == 0:
                stride = (next(ahead) - at) / (POSES * STEPS)
            for _ in range(STEPS):
                turned = np.diff(relative_rotations(robot, np.stack((at, at + stride))), axis=0)[0]
                at = at + stride
                wound += turned - np.abs(turned) * wound / np.maximum(HALF_LAGS, 1e-9)  # Dahl's law in small steps
                wound[HALF_LAGS == 0.0] = 0.0
            lag = np.concatenate((wound[::-1], np.zeros(3)))  # the joints of the preset: outermost tube first
            tip = exact.solve(at - lag, np.zeros(6)).tip + 5e-5 * random.standard_normal(3)
            writer.writerow([number, number // (LINES * POSES), *at.tolist(), *tip.tolist()])


if __name__ == "__main__":
    main()
