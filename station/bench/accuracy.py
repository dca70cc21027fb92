"""`ctr-station bench accuracy` and `bench cost`: the model against the exact rod, and what it costs.

Everything here is drawn from a seed, so that a result can be had again. The tests run a part of it.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from core.errors import NoSolution
from core.model.cosserat import ExactRod, Rod
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Base, Indices, Joint, Robot, Section, Tube
from station.config.robots import load_robot

#: A cold start is wrong when the tip is further than this from every tip the exact rod knows [m].
WRONG = 0.15e-3
#: Half steps of the differences of the exact rod, by the unit of what is moved.
HALF_STEPS = {"rad": 1e-5, "m": 1e-5, "N": 3e-5, "N m": 3e-6}


Integrator = Literal["paper", "fourth_order"]
#: Sub-links at which derivatives are compared, each half the one before [m].
LADDERS: dict[Integrator, tuple[float, ...]] = {
    "paper": (0.010, 0.005, 0.0025),
    "fourth_order": (0.020, 0.010, 0.005, 0.0025),
}


#: The integrators, and when their turn comes in the whole verification.
KINDS: tuple[tuple[Integrator, float], ...] = (("paper", 0.0), ("fourth_order", 0.5))


class Case(NamedTuple):
    """A robot and the poses and loads at which it is tried."""

    robot: Robot
    lower: Array  #: (n,) of the joints
    upper: Array
    force: float  #: largest [N]
    moment: float  #: largest [N m]


def telescope(count: int, base: Base | None = None) -> Robot:
    """1 to 5 tubes of two curved sections each, every one turned and slid by its own motor but the outermost.

    Cut out of one pattern, so that robots of different numbers of tubes can be compared.
    """
    tubes, joints = list[Tube](), list[Joint]()
    for i in range(count):
        out = count - 1 - i  # from the outermost inward
        inner = 0.4e-3 + 0.6e-3 * i
        sections = (Section(0.06 + 0.05 * out), Section(0.08, (3.0, 0.5 * i)), Section(0.05, (5.0, -1.0)))
        gj = 0.012 * 1.6**i if i == 1 else None
        fixed = 0.3 if out == 0 else 0.0
        tubes.append(Tube(f"tube{i}", sections, 0.015 * 1.6**i, 0.3, inner + 0.5e-3, inner, gj, fixed))
        if out > 0 or count == 1:
            joints += [Joint(f"turn{i}", i, "rotation"), Joint(f"slide{i}", i, "translation")]
    return Robot(f"telescope{count}", tuple(tubes), tuple(joints), base or Base())


def cases() -> dict[str, Case]:
    """The robots of the derivative check: two, three and five tubes."""
    found: dict[str, Case] = {}
    for name, force, moment in (("paper", 0.5, 0.02), ("three_tubes", 0.1, 0.003)):
        file = load_robot(name)
        limits = file.limits().joints
        lower, upper = (np.array([getattr(limit, side) for limit in limits]) for side in ("lower", "upper"))
        found[name] = Case(file.robot(), lower, upper, force, moment)
    robot = telescope(5, Base((0.1, -0.2, 0.3), (0.4, -1.2, 0.7)))
    span = [(-math.pi, math.pi) if joint.motion == "rotation" else (-0.22, -0.005) for joint in robot.joints]
    lower, upper = np.array(span).T.copy()
    found[robot.name] = Case(robot, lower, upper, 0.25, 0.01)
    return found


def draw(case: Case, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """Poses at which the tubes stand, and wrenches, without end."""
    while True:
        joints = rng.uniform(case.lower, case.upper)
        directions = rng.normal(size=(2, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        wrench = (directions * rng.uniform(0.0, (case.force, case.moment))[:, None]).ravel()
        if case.robot.stands(joints):
            yield joints, wrench


def cold_starts(
    count: int,
    seed: int = 0,
    integrator: Integrator = "paper",
    done: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """Random poses of the paper's robot, forces up to 0.6 N in any direction, no warm start.

    An answer is right when the exact rod, started cold too, has its tip within `WRONG`, or, where
    several shapes balance the load, when it has one there started from the answer; else wrong.
    """
    case = cases()["paper"]._replace(force=0.6, moment=0.0)
    statics, exact = Statics(case.robot, integrator=integrator), ExactRod(case.robot)
    errors: list[float] = []
    wrong, failed, other, unstable, violation = 0, 0, 0, 0, 0.0
    poses = draw(case, np.random.default_rng(seed))
    for index in range(count):
        joints, wrench = next(poses)
        done(index / count)
        try:
            solution = statics.solve(joints, wrench)
        except NoSolution:
            failed += 1
            continue
        violation = max(violation, statics.residual(solution))
        unstable += solution.stability <= 0.0
        error = _distance(solution, _rod(exact, joints, wrench))
        if error > WRONG:
            other += 1
            error = _distance(solution, _rod(exact, joints, wrench, solution))
            wrong += error > WRONG
        errors.append(error)
    return {
        "starts": count,
        "wrong": wrong,
        "failed": failed,
        "another_shape": other - wrong,
        "unstable": unstable,
        "accuracy_mm": {"mean": _short(1e3 * np.mean(errors)), "max": _short(1e3 * max(errors))},
        "residual": _short(violation),
    }


def derivatives(
    count: int,
    seed: int = 0,
    integrator: Integrator = "paper",
    done: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """J, C and the stability margin against differences of the exact rod, at `LADDERS` of sub-links.

    Relative to the largest entry of each block (position or rotation, by rotations, translations,
    force or moment); the figures are those of the shortest sub-links. A pose where rod and model stand
    on different shapes, or where two sections end so close together that the differences would step
    over it, is drawn again.
    """
    result: dict[str, Any] = {}
    ladder = LADDERS[integrator]
    for number, (name, case) in enumerate(cases().items()):
        exact = ExactRod(case.robot, step=0.001, tolerance=1e-11)
        models = [Statics(case.robot, sublink, integrator) for sublink in ladder]
        errors: dict[str, list[list[float]]] = {"jacobian": [], "compliance": [], "stability": []}
        poses = draw(case, np.random.default_rng(seed))
        skipped = 0
        while len(errors["jacobian"]) < count:
            joints, wrench = next(poses)
            done((number + len(errors["jacobian"]) / count) / 3)
            if not _apart(case.robot, joints):
                skipped += 1
                continue
            try:
                fine = models[-1].solve(joints, wrench)
                rod = _rod(exact, joints, wrench, fine)
                if rod is None or _distance(fine, rod) > 1e-5:
                    raise NoSolution("another shape")
                margin = exact.stability(joints, wrench, rod)
                truth = _differences(exact, joints, wrench, rod)
                solutions = [model.solve(joints, wrench, fine) for model in models]
            except NoSolution:
                skipped += 1
                continue
            n = joints.size
            slides = np.array([joint.motion == "translation" for joint in case.robot.joints])
            groups = [np.flatnonzero(~slides), np.flatnonzero(slides)]
            errors["jacobian"].append([_relative(s.jacobian, truth[:, :n], groups) for s in solutions])
            loads = [np.arange(3), np.arange(3, 6)]
            errors["compliance"].append([_relative(s.compliance, truth[:, n:], loads) for s in solutions])
            errors["stability"].append([abs(s.stability / margin - 1.0) for s in solutions])
        result[name] = {
            what: {
                "max": _short(np.max(table, axis=0)[-1]),
                "p99": _short(np.percentile(table, 99, axis=0)[-1]),
                "median": _short(np.median(table, axis=0)[-1]),
                "falls": [round(float(ratio), 2) for ratio in _falls(np.array(table))],
            }
            for what, table in errors.items()
        } | {"poses": count, "drawn_again": skipped}
    return result


def cost(solves: int = 400, most: int = 5) -> dict[str, Any]:
    """Microseconds of a warm solve with J and C: 1 to `most` tubes, sub-links 5-100, and the load."""
    result: dict[str, Any] = {}
    for tubes in range(1, most + 1):
        robot = telescope(tubes)
        joints = np.array([0.3 if joint.motion == "rotation" else -0.05 for joint in robot.joints])
        for i, joint in enumerate(robot.joints):
            if joint.motion == "translation":
                joints[i] = -0.02 * (tubes - joint.tube)
        length = float(robot.tube_poses(joints)[1][0]) + robot.tubes[0].length
        row: dict[str, float] = {}
        for count in (5, 10, 20, 50, 100):
            statics = Statics(robot, length / count)
            row[f"{count} sub-links"] = _warm(statics, joints, 0.1, solves)
        row["fourth order, 30 mm"] = _warm(Statics(robot, integrator="fourth_order"), joints, 0.1, solves)
        result[f"{tubes} tubes"] = row
    paper = load_robot("paper").robot()
    at = np.array([0.0, math.pi / 2, -0.1])
    result["paper by load"] = {f"{load} N": _warm(Statics(paper), at, load, solves) for load in (0.0, 0.2, 0.5, 1.0)}
    cold = [_cold(Statics(paper), at, load, solves) for load in (0.0, 0.2, 0.5, 1.0)]
    result["paper cold by load"] = dict(zip(result["paper by load"], cold, strict=True))
    return result


def accuracy(done: Callable[[float], None] = lambda _: None) -> dict[str, Any]:
    """The whole verification: 20 000 cold starts with each integrator, 500 poses of three robots."""
    return {
        kind: {
            "cold_starts": cold_starts(20_000, 0, kind, lambda part, at=at: done(at + 0.1 * part)),
            "derivatives": derivatives(500, 0, kind, lambda part, at=at: done(at + 0.1 + 0.4 * part)),
        }
        for kind, at in KINDS
    }


def _rod(exact: ExactRod, joints: Array, wrench: Array, near: Solution | None = None) -> Rod | None:
    """The exact shape, cold or from the base unknowns of a solution; None when there is none."""
    q = len(exact.robot.tubes)
    start = None
    if near is not None:
        moment = exact.robot.base.rotation.T @ near.unknowns[q:]
        unknowns = np.concatenate((moment[:2], near.unknowns[:q]))
        start = Rod(near.tip, near.rotation, unknowns[2:], unknowns, np.zeros((q + 2, q + 2)), 0)
    try:
        return exact.solve(joints, wrench, start)
    except NoSolution:
        return None


def _apart(robot: Robot, joints: Array) -> bool:
    """Whether all ends of sections, and the plate, are further apart than the differences reach."""
    beta = robot.tube_poses(joints)[1]
    ends = [
        start + end for tube, start in enumerate(beta) for end in robot.layout.ends[tube, : robot.layout.counts[tube]]
    ]
    return bool(np.diff(np.sort([0.0, *ends])).min() > 3.0 * HALF_STEPS["m"])


def _distance(solution: Solution, rod: Rod | None) -> float:
    return math.inf if rod is None else float(np.linalg.norm(solution.tip - rod.tip))


def _differences(exact: ExactRod, joints: Array, wrench: Array, rod: Rod) -> Array:
    """Position and rotation (6) of the exact tip by joints, force and moment (n + 6): central differences."""
    n = joints.size
    halves = [HALF_STEPS[joint.unit] for joint in exact.robot.joints] + 3 * [HALF_STEPS["N"]] + 3 * [HALF_STEPS["N m"]]
    columns = np.empty((6, n + 6))
    for k, half in enumerate(halves):
        move = np.zeros(n + 6)
        move[k] = half
        up, down = (exact.solve(joints + s * move[:n], wrench + s * move[n:], rod) for s in (1.0, -1.0))
        turn = up.rotation @ down.rotation.T
        columns[:3, k] = up.tip - down.tip
        columns[3:, k] = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        columns[:, k] /= 2.0 * half
    return columns


def _relative(found: Array, truth: Array, groups: Sequence[Indices]) -> float:
    """Largest error over the largest entry of its block."""
    worst = 0.0
    for rows in (slice(0, 3), slice(3, 6)):
        for columns in groups:
            if columns.size:
                block = np.take(truth[rows], columns, axis=1)
                worst = max(
                    worst, float(np.abs(np.take(found[rows], columns, axis=1) - block).max() / np.abs(block).max())
                )
    return worst


def _short(number: Any) -> float:
    return float(f"{float(number):.3g}")


def _falls(table: Array) -> Array:
    means = np.mean(table, axis=0)
    return means[:-1] / means[1:]


def _warm(statics: Statics, joints: Array, load: float, solves: int) -> float:
    """Median time of a solve while the joints move on by 1 mrad and 30 um at a time [us]."""
    wrench = np.array([load, 0.0, 0.0, 0.0, 0.0, 0.0])
    move = np.array([1e-3 if joint.motion == "rotation" else -3e-5 for joint in statics.robot.joints])
    near = statics.solve(joints, wrench)
    times = np.empty(solves)
    for index in range(solves):
        # back and forth, so that no end of travel is reached
        at = joints + (50 - abs(index % 100 - 50)) * move
        start = time.perf_counter()
        near = statics.solve(at, wrench, near)
        times[index] = time.perf_counter() - start
    return round(1e6 * float(np.median(times)), 2)


def _cold(statics: Statics, joints: Array, load: float, solves: int) -> float:
    wrench = np.array([load, 0.0, 0.0, 0.0, 0.0, 0.0])
    times = np.empty(solves)
    for index in range(solves):
        start = time.perf_counter()
        statics.solve(joints, wrench)
        times[index] = time.perf_counter() - start
    return round(1e6 * float(np.median(times)), 2)
