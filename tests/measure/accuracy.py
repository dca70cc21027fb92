"""`python -m tests.measure accuracy` and `cost`: accuracy of the model against the exact rod, and time of a solve.

All poses are drawn from a seed, so that results can be reproduced. The unit tests run a hundredth of the verification.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from core.errors import NoSolution
from core.model.cosserat import HALF_STEPS, ExactRod, Rod
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Base, Indices, Joint, Robot, Section, Tube
from station.config.robots import load_robot

#: A solution without a warm start is wrong if its tip is further than this from the tips of the exact rod [m].
MAX_COLD_ERROR_M = 0.15e-3

Integrator = Literal["paper", "fourth_order"]
#: Sub-link lengths at which derivatives are compared, by integrator; each length is half of the previous one [m].
SUBLINK_LADDERS_M: dict[Integrator, tuple[float, ...]] = {
    "paper": (0.010, 0.005, 0.0025),
    "fourth_order": (0.020, 0.010, 0.005, 0.0025),
}


#: Integrators to verify, each with the fraction of the whole verification that is done when its part starts.
INTEGRATOR_SCHEDULE: tuple[tuple[Integrator, float], ...] = (("paper", 0.0), ("fourth_order", 0.5))


class AccuracyCase(NamedTuple):
    """A robot with the ranges of its test poses and loads."""

    robot: Robot
    lower: Array  #: smallest position of each joint (n,) [rad or m]
    upper: Array
    force: float  #: largest force at the tip [N]
    moment: float  #: largest moment at the tip [N m]


def telescope(count: int, base: Base | None = None) -> Robot:
    """Return a robot of 1 to 5 tubes, each with two curved sections.

    Every tube rotates and translates, except the outermost tube of several. The robots follow one pattern, so that
    robots with different numbers of tubes can be compared.
    """
    tubes, joints = list[Tube](), list[Joint]()
    for i in range(count):
        out = count - 1 - i  # number of tubes around this tube
        inner = 0.4e-3 + 0.6e-3 * i
        sections = (Section(0.06 + 0.05 * out), Section(0.08, (3.0, 0.5 * i)), Section(0.05, (5.0, -1.0)))
        gj = 0.012 * 1.6**i if i == 1 else None
        fixed = 0.3 if out == 0 else 0.0
        tubes.append(Tube(f"tube{i}", sections, 0.015 * 1.6**i, 0.3, inner + 0.5e-3, inner, gj, fixed))
        if out > 0 or count == 1:
            joints += [Joint(f"turn{i}", i, "rotation"), Joint(f"slide{i}", i, "translation")]
    return Robot(f"telescope{count}", tuple(tubes), tuple(joints), base or Base())


def cases() -> dict[str, AccuracyCase]:
    """Return the robots of the derivative check: two, three and five tubes."""
    found: dict[str, AccuracyCase] = {}
    for name, force, moment in (("paper", 0.5, 0.02), ("three_tubes", 0.1, 0.003)):
        file = load_robot(name)
        limits = file.limits().joints
        lower, upper = (np.array([getattr(limit, side) for limit in limits]) for side in ("lower", "upper"))
        found[name] = AccuracyCase(file.robot(), lower, upper, force, moment)
    robot = telescope(5, Base((0.1, -0.2, 0.3), (0.4, -1.2, 0.7)))
    span = [(-math.pi, math.pi) if joint.motion == "rotation" else (-0.22, -0.005) for joint in robot.joints]
    lower, upper = np.array(span).T.copy()
    found[robot.name] = AccuracyCase(robot, lower, upper, 0.25, 0.01)
    return found


def draw(case: AccuracyCase, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """Yield random pairs of a valid pose and a wrench, without an end."""
    while True:
        joints = rng.uniform(case.lower, case.upper)
        directions = rng.normal(size=(2, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        wrench = (directions * rng.uniform(0.0, (case.force, case.moment))[:, None]).ravel()
        if case.robot.is_valid_pose(joints):
            yield joints, wrench


def cold_starts(
    count: int, seed: int = 0, integrator: Integrator = "paper", done: Callable[[float], None] = lambda _: None
) -> dict[str, Any]:
    """Solve random poses of the paper's robot without a warm start, under forces up to 0.6 N in any direction.

    A solution is correct if its tip is at most `MAX_COLD_ERROR_M` from the tip of the exact rod, also solved without a
    warm start. The robot may have several shapes under one load. So another solution is compared again, with the exact
    rod solved from this solution as its start; if both then agree, the result counts it as `another_shape`.
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
        if error > MAX_COLD_ERROR_M:
            other += 1
            error = _distance(solution, _rod(exact, joints, wrench, solution))
            wrong += error > MAX_COLD_ERROR_M
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
    count: int, seed: int = 0, integrator: Integrator = "paper", done: Callable[[float], None] = lambda _: None
) -> dict[str, Any]:
    """Compare J, C and the stability margin of the model with those of the exact rod.

    J and C of the exact rod are finite differences. Their errors are relative to the largest entry of each block; a
    block has the rows of position or rotation and the columns of rotations, translations, force or moment. The numbers
    are those of the shortest sub-links in `SUBLINK_LADDERS_M`; `falls` are the ratios of mean errors from one length
    to the next. Another pose is drawn if rod and model have different shapes, or if the ends of two sections are so
    close together that a finite difference would move one end past the other.
    """
    result: dict[str, Any] = {}
    ladder = SUBLINK_LADDERS_M[integrator]
    for number, (name, case) in enumerate(cases().items()):
        exact = ExactRod(case.robot, step=0.001, tolerance=1e-11)
        models = [Statics(case.robot, sublink, integrator) for sublink in ladder]
        errors: dict[str, list[list[float]]] = {"jacobian": [], "compliance": [], "stability": []}
        poses = draw(case, np.random.default_rng(seed))
        skipped = 0
        while len(errors["jacobian"]) < count:
            joints, wrench = next(poses)
            done((number + len(errors["jacobian"]) / count) / 3)
            if not apart(case.robot, joints):
                skipped += 1
                continue
            try:
                fine = models[-1].solve(joints, wrench)
                rod = _rod(exact, joints, wrench, fine)
                if rod is None or _distance(fine, rod) > 1e-5:
                    raise NoSolution("another shape")
                margin = exact.stability(joints, wrench, rod)
                truth = exact.derivatives(joints, wrench, rod)
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


def cost(solves: int = 400, max_tubes: int = 5) -> dict[str, Any]:
    """Return times of a solve with J and C [us]: by 1 to `max_tubes` tubes with 5 to 100 sub-links, and by load."""
    result: dict[str, Any] = {}
    for tubes in range(1, max_tubes + 1):
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
    """Run the whole verification with each integrator: 20 000 cold starts, and derivatives at 500 poses of 3 robots."""
    return {
        kind: {
            "cold_starts": cold_starts(20_000, 0, kind, lambda part, at=at: done(at + 0.1 * part)),
            "derivatives": derivatives(500, 0, kind, lambda part, at=at: done(at + 0.1 + 0.4 * part)),
        }
        for kind, at in INTEGRATOR_SCHEDULE
    }


def _rod(exact: ExactRod, joints: Array, wrench: Array, near: Solution | None = None) -> Rod | None:
    """Return the exact rod, solved cold or from the base unknowns of `near`; None if it has no solution."""
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


def apart(robot: Robot, joints: Array) -> bool:
    """Return whether plate and ends of sections are so far apart that no finite difference moves one past another."""
    beta = robot.tube_poses(joints)[1]
    ends = [
        start + end for tube, start in enumerate(beta) for end in robot.layout.ends[tube, : robot.layout.counts[tube]]
    ]
    return bool(np.diff(np.sort([0.0, *ends])).min() > 3.0 * HALF_STEPS["m"])


def _distance(solution: Solution, rod: Rod | None) -> float:
    return math.inf if rod is None else float(np.linalg.norm(solution.tip - rod.tip))


def _relative(found: Array, truth: Array, groups: Sequence[Indices]) -> float:
    """Return the largest error of all blocks; an error is divided by the largest true entry of its block."""
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
    """Return the median time of a solve while the joints move by 1 mrad and 30 um per solve [us]."""
    wrench = np.array([load, 0.0, 0.0, 0.0, 0.0, 0.0])
    move = np.array([1e-3 if joint.motion == "rotation" else -3e-5 for joint in statics.robot.joints])
    near = statics.solve(joints, wrench)
    times = np.empty(solves)
    for index in range(solves):
        # The joints move back and forth, so that none reaches the end of its travel.
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
