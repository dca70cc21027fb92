"""Benchmark: the controller keeps the tip in position from 200 random start poses, with random plants and loads.

Every seed draws a plant, i.e. a simulated real robot whose EI and curvatures differ by up to 8 % from the model. It
also draws a start pose in the whole travel and the direction of a load that rises and falls. The tip must keep its
position. At some poses no joint positions exist that keep the tip there. A bounded least-squares search on the *true*
plant, from 20 start values at each of four loads, finds these poses; their runs should end in HOLD with the limit
named.

    python -m tests.measure.starts --seeds 200 --jobs 2
    python -m tests.measure.starts --seeds 200 --experiment points   # six joints, position and direction, 0.3 N
"""

import argparse
import json
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from scipy.optimize import least_squares

from core.control.tip_direction import shortest_rotation, task_rows
from core.errors import CtrError
from core.model.cosserat import ExactRod
from core.robot.robot import Array
from station.config.loads import RaisedCosineLoad
from station.config.motions import HoldMotion, Orders
from station.control.clock import VirtualClock
from station.experiments.experiment import Case, load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case
from station.lab.plant import true_robot

#: Default experiment, whose first case has the controller and the lab; and the peak of the load by experiment [N].
EXPERIMENT = "fig8"
PEAK_FORCES_N = {EXPERIMENT: 0.5, "points": 0.3}
DURATION_S = 20.0  # duration of a run, one period of the load [s]
SETTLING_S = 2.0  # errors count from this time on [s]
PLANT_VARIATION = 0.08  # largest relative deviation of the plant's EI and curvature
MAX_ROTATION_RAD, TRAVEL_MARGIN_M = (
    math.pi,
    0.005,
)  # largest rotation to either side [rad], and margin at both ends of a translation's travel [m]
#: A start is holdable if the search brings the true tip at least this near to its start position under each load [m].
HOLDABLE_ERROR_M = 1e-4
LOAD_LEVELS = (0.25, 0.5, 0.75, 1.0)  # loads of the search, as fractions of the peak
SEARCH_COUNT = 20


class RandomStart(NamedTuple):
    """Start pose and load that a seed draws."""

    joints: Array  #: start pose (n,) [rad or m]
    direction: tuple[float, float, float]  #: direction of the load, a unit vector
    peak: float  #: peak of the load [N]


class StartOutcome(NamedTuple):
    """Result of the run from one start pose."""

    seed: int
    joints: tuple[float, ...]
    direction: tuple[float, ...]
    holdable: bool
    reference_mm: float  #: result of `reference_error` [mm]
    completed: bool
    cause: str
    error_mm: float  #: largest true error of an axis from the settling time to the end of the run [mm]


def bounds(case: Case) -> tuple[Array, Array]:
    """Return lower and upper bound (n,) of random start joints [rad or m]."""
    turns = np.array([joint.motion == "rotation" for joint in case.controller.statics.robot.joints])
    lower, upper = case.controller.limits.packed[:2]
    return np.where(turns, -MAX_ROTATION_RAD, lower + TRAVEL_MARGIN_M), np.where(
        turns, MAX_ROTATION_RAD, upper - TRAVEL_MARGIN_M
    )


def draw(seed: int, case: Case, peak: float) -> RandomStart:
    """Draw a valid start pose and the direction of the load."""
    rng = np.random.default_rng([seed, 5])
    direction = rng.normal(size=3)
    joints = rng.uniform(*bounds(case))
    while not case.controller.statics.robot.is_valid_pose(joints):
        joints = rng.uniform(*bounds(case))
    return RandomStart(joints, tuple((direction / np.linalg.norm(direction)).tolist()), peak)


def prepare_case(case: Case, start: RandomStart) -> Case:
    """Return the case with the pose and load of `start`, a tip that keeps its position, and a varied plant."""
    file = case.file.model_copy(
        update={
            "start": dict(zip(case.controller.statics.robot.joint_names, start.joints.tolist(), strict=True)),
            "duration": DURATION_S,
            "settling": SETTLING_S,
            "trajectory": HoldMotion(),
            "load": RaisedCosineLoad(peak=start.peak, period=DURATION_S, direction=start.direction),
        }
    )
    lab = case.lab.model_copy(update={"plant": case.lab.plant.model_copy(update={"vary": PLANT_VARIATION})})
    orders = Orders(HoldMotion(), case.controller.statics.robot)
    return case._replace(file=file, lab=lab, orders=orders, start=start.joints)


def reference_error(case: Case, seed: int, start: RandomStart) -> float:
    """Return the smallest distance of the true tip from its start that any joints reach, under the worst load [m].

    If the controller also controls the direction of the tip, an error of the direction is converted to a distance.
    """
    # The simulated lab draws its plant with the first of three random streams of the seed, so this plant is the same.
    plant = np.random.default_rng(np.random.SeedSequence(seed).spawn(3)[0])
    rod = ExactRod(true_robot(case.controller.statics.robot, case.lab.plant, plant), step=0.02, tolerance=1e-8)
    target, aim = rod.solve(start.joints, np.zeros(6)), case.controller.aim
    units = np.where(bounds(case)[1] == MAX_ROTATION_RAD, 1.0, 0.05)
    joints = case.controller.limits.joints
    lower, upper = np.array([joint.lower for joint in joints]), np.array([joint.upper for joint in joints])
    rng = np.random.default_rng([seed, 6])
    nearest, worst = start.joints, 0.0
    for level in LOAD_LEVELS:
        wrench = np.r_[level * start.peak * np.array(start.direction), np.zeros(3)]

        def miss(joints: Array, wrench: Array = wrench) -> Array:
            try:
                found = rod.solve(joints, wrench)
            except CtrError:
                return np.full(aim.rows, 1e3)
            away = np.concatenate(
                (found.tip - target.tip, shortest_rotation(target.rotation[:, 2], found.rotation[:, 2]))
            )
            return 1e3 * task_rows(aim, away[:, None], target.rotation)[:, 0]

        best = math.inf
        for guess in (nearest, start.joints, *rng.uniform(*bounds(case), (SEARCH_COUNT - 2, start.joints.size))):
            guess = np.clip(guess, lower + 1e-9, upper - 1e-9)
            found = least_squares(miss, guess, bounds=(lower, upper), x_scale=units, xtol=1e-10, max_nfev=60)
            if found.cost < best:
                best, nearest = found.cost, found.x
            if math.sqrt(2.0 * best) < 1e-3:
                break
        worst = max(worst, 1e-3 * math.sqrt(2.0 * best))
    return worst


def run_start(seed: int, experiment: str = EXPERIMENT) -> StartOutcome:
    """Draw the start of a seed, run the simulation, and return the result."""
    case = load_experiment(experiment).cases[0]
    start = draw(seed, case, PEAK_FORCES_N[experiment])
    case = prepare_case(case, start)
    reference = reference_error(case, seed, start)
    recording = run_case(case, seed, VirtualClock(), lambda _: None)
    return StartOutcome(
        seed, tuple(start.joints.tolist()), start.direction, reference <= HOLDABLE_ERROR_M, 1e3 * reference,
        recording.completed, recording.cause, max(summarise(recording).get("true_max_abs_error_mm", [math.nan])),
    )  # fmt: skip


def sweep(
    seeds: Sequence[int], jobs: int, report: Callable[[StartOutcome], None], experiment: str = EXPERIMENT
) -> list[StartOutcome]:
    """Run all seeds in `jobs` processes and return their results; `report` receives each result."""
    outcomes: list[StartOutcome] = []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for outcome in pool.map(run_start, seeds, [experiment] * len(seeds)):
            report(outcome)
            outcomes.append(outcome)
    return outcomes


def summary(outcomes: Sequence[StartOutcome]) -> dict[str, Any]:
    """Return statistics of the largest axis errors of holdable starts [mm] (infinite after HOLD), and other results."""
    holdable = [outcome for outcome in outcomes if outcome.holdable]
    others = [outcome for outcome in outcomes if not outcome.holdable]
    errors = sorted(outcome.error_mm if outcome.completed else math.inf for outcome in holdable)
    completed = [outcome for outcome in others if outcome.completed]
    return {
        "starts": len(outcomes),
        "holdable": len(holdable),
        "error_mm": {
            f"p{part}": errors[math.ceil(part / 100.0 * len(errors)) - 1] for part in (50, 90, 95, 100) if errors
        },
        "holdable_above_0.7_mm": [outcome.seed for outcome in holdable if not outcome.error_mm <= 0.7],
        "holdable_but_hold": [outcome.seed for outcome in holdable if not outcome.completed],
        "not_holdable": len(others),
        "not_holdable_and_hold": len(others) - len(completed),
        "not_holdable_but_completed": [
            {"seed": o.seed, "error_mm": round(o.error_mm, 3), "reference_mm": round(o.reference_mm, 3)}
            for o in completed
        ],
    }


def main() -> None:
    """Run the seeds that the command line requests, and print their results."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.measure.starts", description="hold the tip at many start poses"
    )
    parser.add_argument("--seeds", type=int, default=200, metavar="N", help="number of starts (200)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="parallel processes (2)")
    parser.add_argument("--experiment", choices=PEAK_FORCES_N, default=EXPERIMENT, help="robot and controller (fig8)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="file for every outcome as a line of JSON")
    parsed = parser.parse_args()
    lines: list[str] = []
    with Console(stderr=True).status("starts") as status:

        def report(outcome: StartOutcome) -> None:
            lines.append(json.dumps(outcome._asdict()))
            status.update(f"{len(lines)} of {parsed.seeds} starts")
            if parsed.out is not None:
                parsed.out.write_text("\n".join(lines) + "\n", encoding="utf-8")

        outcomes = sweep(range(parsed.seeds), parsed.jobs, report, parsed.experiment)
    Console(highlight=False).print_json(data=summary(outcomes))


if __name__ == "__main__":
    main()
