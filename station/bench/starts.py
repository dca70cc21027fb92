"""Holding the tip from wherever the robot happens to stand: two hundred plants, poses and loads.

Every seed draws a plant (EI and curvature within +-8 %), a start pose from the whole travel and the
direction of a load that comes and goes; the tip is to stay where it is. Some poses cannot hold it: a
reference inverse on the *true* plant says which, by a bounded least-squares search from 20 places
at each of a few loads. There the run should end in HOLD with the limit named.

    python -m station.bench.starts --seeds 200 --jobs 2
    python -m station.bench.starts --seeds 200 --experiment points   # six joints, place and direction, 0.3 N
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

from core.control.pointing import rows_of, turn
from core.errors import CtrError
from core.model.cosserat import ExactRod
from core.robot.robot import Array
from station.config.motions import HoldMotion, Orders
from station.control.clock import VirtualClock
from station.experiments.experiment import Case, load_experiment
from station.experiments.results import summarise
from station.experiments.runner import run_case
from station.lab.loads import RaisedCosineLoad
from station.lab.plant import true_robot

#: Whose controller and lab it is, that of the first case, and how hard is pulled [N].
EXPERIMENT = "fig8"
PEAKS = {EXPERIMENT: 0.5, "points": 0.3}
DURATION = 20.0  # [s], one period of the load
SETTLING = 2.0  # [s]
VARY = 0.08  # of EI and curvature
TURN, ROOM = math.pi, 0.005  # either way [rad], and left at either end of a translation's travel [m]
#: A tip counts as holdable when the reference comes this close to it at each of these loads.
HOLDABLE = 1e-4  # [m]
LEVELS = (0.25, 0.5, 0.75, 1.0)  # of the peak
SEARCHES = 20


class Start(NamedTuple):
    """What a seed draws."""

    joints: Array  #: (n,) [rad or m]
    direction: tuple[float, float, float]  #: of the load
    peak: float  #: of it [N]


class Outcome(NamedTuple):
    """How one start went."""

    seed: int
    joints: tuple[float, ...]
    direction: tuple[float, ...]
    holdable: bool
    reference_mm: float  #: what the reference inverse leaves, at the worst of the loads
    completed: bool
    cause: str
    error_mm: float  #: largest true error of any axis after settling; of an unfinished run until its end


def bounds(case: Case) -> tuple[Array, Array]:
    """Between which joints (n,) starts are drawn [rad or m]."""
    turns = np.array([joint.motion == "rotation" for joint in case.controller.statics.robot.joints])
    lower, upper = case.controller.limits.packed[:2]
    return np.where(turns, -TURN, lower + ROOM), np.where(turns, TURN, upper - ROOM)


def draw(seed: int, case: Case, peak: float) -> Start:
    """Start pose at which the tubes can stand, and direction of the load."""
    rng = np.random.default_rng([seed, 5])
    direction = rng.normal(size=3)
    joints = rng.uniform(*bounds(case))
    while not case.controller.statics.robot.stands(joints):
        joints = rng.uniform(*bounds(case))
    return Start(joints, tuple((direction / np.linalg.norm(direction)).tolist()), peak)


def prepared(case: Case, start: Start) -> Case:
    """The case from that start, under that load, with a plant of its own."""
    file = case.file.model_copy(
        update={
            "start": dict(zip(case.controller.statics.robot.joint_names, start.joints.tolist(), strict=True)),
            "duration": DURATION,
            "settling": SETTLING,
            "trajectory": HoldMotion(),
            "load": RaisedCosineLoad(peak=start.peak, period=DURATION, direction=start.direction),
        }
    )
    lab = case.lab.model_copy(update={"plant": case.lab.plant.model_copy(update={"vary": VARY})})
    orders = Orders(HoldMotion(), case.controller.statics.robot)
    return case._replace(file=file, lab=lab, orders=orders, start=start.joints)


def reference_error(case: Case, seed: int, start: Start) -> float:
    """How far from the start tip the best joints within their travel leave the true plant, at the worst load [m].

    What is asked of the direction counts as the way at its lever.
    """
    # The plant draws from the first of the lab's streams.
    plant = np.random.default_rng(np.random.SeedSequence(seed).spawn(3)[0])
    rod = ExactRod(true_robot(case.controller.statics.robot, case.lab.plant, plant), step=0.02, tolerance=1e-8)
    target, aim = rod.solve(start.joints, np.zeros(6)), case.controller.aim
    units = np.where(bounds(case)[1] == TURN, 1.0, 0.05)
    joints = case.controller.limits.joints
    lower, upper = np.array([joint.lower for joint in joints]), np.array([joint.upper for joint in joints])
    rng = np.random.default_rng([seed, 6])
    nearest, worst = start.joints, 0.0
    for level in LEVELS:
        wrench = np.r_[level * start.peak * np.array(start.direction), np.zeros(3)]

        def miss(joints: Array, wrench: Array = wrench) -> Array:
            try:
                found = rod.solve(joints, wrench)
            except CtrError:
                return np.full(aim.rows, 1e3)
            away = np.concatenate((found.tip - target.tip, turn(target.rotation[:, 2], found.rotation[:, 2])))
            return 1e3 * rows_of(aim, away[:, None], target.rotation)[:, 0]

        best = math.inf
        for guess in (nearest, start.joints, *rng.uniform(*bounds(case), (SEARCHES - 2, start.joints.size))):
            guess = np.clip(guess, lower + 1e-9, upper - 1e-9)
            found = least_squares(miss, guess, bounds=(lower, upper), x_scale=units, xtol=1e-10, max_nfev=60)
            if found.cost < best:
                best, nearest = found.cost, found.x
            if math.sqrt(2.0 * best) < 1e-3:
                break
        worst = max(worst, 1e-3 * math.sqrt(2.0 * best))
    return worst


def run_start(seed: int, experiment: str = EXPERIMENT) -> Outcome:
    """One seed."""
    case = load_experiment(experiment).cases[0]
    start = draw(seed, case, PEAKS[experiment])
    case = prepared(case, start)
    reference = reference_error(case, seed, start)
    recording = run_case(case, seed, VirtualClock(), lambda _: None)
    return Outcome(
        seed, tuple(start.joints.tolist()), start.direction, reference <= HOLDABLE, 1e3 * reference,
        recording.completed, recording.cause, max(summarise(recording).get("true_max_abs_error_mm", [math.nan])),
    )  # fmt: skip


def sweep(
    seeds: Sequence[int], jobs: int, told: Callable[[Outcome], None], experiment: str = EXPERIMENT
) -> list[Outcome]:
    """All seeds, `jobs` at a time."""
    outcomes: list[Outcome] = []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        for outcome in pool.map(run_start, seeds, [experiment] * len(seeds)):
            told(outcome)
            outcomes.append(outcome)
    return outcomes


def summary(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Largest axis errors [mm] over the holdable starts (a HOLD counts as infinite), and what became of the others."""
    holdable = [outcome for outcome in outcomes if outcome.holdable]
    others = [outcome for outcome in outcomes if not outcome.holdable]
    errors = sorted(outcome.error_mm if outcome.completed else math.inf for outcome in holdable)
    went_on = [outcome for outcome in others if outcome.completed]
    return {
        "starts": len(outcomes),
        "holdable": len(holdable),
        "error_mm": {
            f"p{part}": errors[math.ceil(part / 100.0 * len(errors)) - 1] for part in (50, 90, 95, 100) if errors
        },
        "holdable_above_0.7_mm": [outcome.seed for outcome in holdable if not outcome.error_mm <= 0.7],
        "holdable_but_hold": [outcome.seed for outcome in holdable if not outcome.completed],
        "not_holdable": len(others),
        "not_holdable_and_hold": len(others) - len(went_on),
        "not_holdable_but_completed": [
            {"seed": o.seed, "error_mm": round(o.error_mm, 3), "reference_mm": round(o.reference_mm, 3)}
            for o in went_on
        ],
    }


def main() -> None:
    """Run the sweep and print what came of it."""
    parser = argparse.ArgumentParser(prog="python -m station.bench.starts", description="hold the tip from many starts")
    parser.add_argument("--seeds", type=int, default=200, metavar="N", help="how many starts (200)")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes side by side (2)")
    parser.add_argument("--experiment", choices=PEAKS, default=EXPERIMENT, help="whose robot and controller (fig8)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="every outcome as a line of JSON")
    parsed = parser.parse_args()
    lines: list[str] = []
    with Console(stderr=True).status("starts") as status:

        def told(outcome: Outcome) -> None:
            lines.append(json.dumps(outcome._asdict()))
            status.update(f"{len(lines)} of {parsed.seeds} starts")
            if parsed.out is not None:
                parsed.out.write_text("\n".join(lines) + "\n", encoding="utf-8")

        outcomes = sweep(range(parsed.seeds), parsed.jobs, told, parsed.experiment)
    Console(highlight=False).print_json(data=summary(outcomes))


if __name__ == "__main__":
    main()
