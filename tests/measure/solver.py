"""`python -m tests.measure solver`: solves without a warm start for many kinds of robots, unloaded and loaded.

The robots have two, three or four random tubes, or three published tubes, with EI / GJ from 1.0 to 2.0 or as
published. Their poses are random and valid. Every pose without load must have a solution, and nearly every pose under a
force. Each solution must be stable, which `lowest` checks. Each solution must also be the shape that the robot
reaches from rest: the exact rod, moved in small steps, shows this shape. All poses are drawn from a seed. The
unit tests run a part of these poses.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from core.errors import NoSolution
from core.model.cosserat import ExactRod, Rod
from core.model.solution import Solution
from core.model.statics import Statics
from core.robot.robot import Array, Joint, Robot, Section, Tube

#: Half step of the finite differences of the energy [rad].
HALF_STEP_RAD = 2e-3
#: Numerical error of an eigenvalue whose exact value is zero; elements and finite differences cause this error.
ZERO_EIGENVALUE = 1e-6


def lowest(robot: Robot, solution: Solution, longest: float = 0.005) -> float:
    """Return the smallest eigenvalue of the energy's second derivatives, divided by their largest diagonal entry.

    A negative value means that the shape is unstable. The shape is divided into elements. Each element has a frame at
    each end, and the rotations of the tubes there. The logarithm of the rotation between both frames gives curvature
    and torsion, and these give the elastic energy. Small changes of all variables give the second derivatives. Only the
    shape comes from the solver. This computation uses no equation of equilibrium and no analytic second variation, and
    its discretisation differs from that of the solver.

    Args:
        robot: robot with the tubes.
        solution: shape under a force at the tip; a moment is ignored, because it has no potential energy.
        longest: length of the longest element [m].

    """
    from scipy.linalg import eigvals_banded  # pyright: ignore  - slow to import

    bands, stiffest = _bands(robot, solution, longest)
    return float(eigvals_banded(bands, select="i", select_range=(0, 0))[0]) / stiffest  # pyright: ignore


def _bands(robot: Robot, solution: Solution, longest: float) -> tuple[Array, float]:
    """Return the upper bands of the second derivatives by (x, y, psi_1 ... psi_q) of the nodes, and the largest."""
    q = len(robot.tubes)
    size = q + 2
    path = Statics(robot, longest, "fourth_order").shape(solution)
    path = path[np.append(np.diff(path[:, 0]) > 1e-9, True)]
    nodes, h = path[:, 0], np.diff(path[:, 0])
    frames = np.array([_quaternion(row[1:10].reshape(3, 3)) for row in path])
    theta = path[:, 13 : 13 + q]
    beta = robot.tube_poses(solution.joints)[1]
    middle = 0.5 * (nodes[1:] + nodes[:-1])
    bend, free = _tubes(robot, beta, middle)
    force = np.where(middle[:, None] < solution.contact, solution.wrench[:3], 0.0)

    def energy(change: Array) -> Array:
        """Return the energy of each element (..., m) after changes (..., 2 size) of the variables at its two ends."""
        start = _product(frames[:-1], _turn(change[..., 0], change[..., 1]))
        end = _product(frames[1:], _turn(change[..., size], change[..., size + 1]))
        first, second = theta[:-1] + change[..., 2:size], theta[1:] + change[..., size + 2 :]
        between = _logarithm(_product(_conjugate(start), end))
        strain = between / h[:, None]
        turned = 0.5 * (first + second)
        cos, sin = np.cos(turned), np.sin(turned)
        x = strain[..., None, 0] - (cos * free[..., 0] - sin * free[..., 1])
        y = strain[..., None, 1] - (sin * free[..., 0] + cos * free[..., 1])
        torsion = (second - first) / h[:, None] + strain[..., None, 2]
        stored = 0.5 * (bend[0] * (x * x + y * y) + bend[1] * torsion * torsion).sum(axis=-1)
        tangent = _tangent(_product(start, _exponential(0.5 * between)))
        return h * (stored - (force * tangent).sum(axis=-1))

    count = 2 * size
    local = np.empty((h.size, count, count))
    unit = HALF_STEP_RAD * np.eye(count)[:, None, :]
    for i in range(count):
        up, down = energy(unit + unit[i]), energy(-unit + unit[i])
        up2, down2 = energy(unit - unit[i]), energy(-unit - unit[i])
        local[:, i, :] = ((up - down - up2 + down2) / (4.0 * HALF_STEP_RAD * HALF_STEP_RAD)).T

    bands = np.zeros((2 * size, size * nodes.size))
    for i in range(count):
        for j in range(i, count):
            bands[2 * size - 1 + i - j, j : j + size * h.size : size] += local[:, i, j]
    stiffest = float(bands[-1].max())
    for i in range(q):
        hidden = -beta[i]
        bands[-1, 2 + i] += min(bend[1][0, i] / max(hidden, 1e-12), 1e3 * stiffest)
        beyond = np.flatnonzero(bend[0][:, i] == 0.0) + 1
        bands[-1, size * beyond + 2 + i] = stiffest
    bands[-1, :2] += 1e3 * stiffest  # a stiff spring clamps the shape at the plate
    return bands, stiffest


def _tubes(robot: Robot, beta: Array, arc_lengths: Array) -> tuple[Array, Array]:
    """Return EI and GJ (2, m, q), and precurvature (m, q, 2), of the tubes at arc lengths (m,)."""
    stiffness, curvature = np.zeros((2, arc_lengths.size, beta.size)), np.zeros((arc_lengths.size, beta.size, 2))
    for i, tube in enumerate(robot.tubes):
        end = beta[i]
        for section in tube.sections:
            there = (arc_lengths >= end) & (arc_lengths < end + section.length)
            stiffness[0, there, i] = tube.bending_stiffness
            stiffness[1, there, i] = tube.bending_stiffness / tube.stiffness_ratio
            curvature[there, i] = section.curvature
            end += section.length
    return stiffness, curvature


def _quaternion(rotation: Array) -> Array:
    """Return the quaternion (w, x, y, z) of a rotation matrix."""
    from scipy.spatial.transform import Rotation  # pyright: ignore  - slow to import

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([w, x, y, z])


def _product(p: Array, q: Array) -> Array:
    a, b, c, d = (p[..., i] for i in range(4))
    e, f, g, h = (q[..., i] for i in range(4))
    return np.stack(
        (
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ),
        axis=-1,
    )


def _conjugate(p: Array) -> Array:
    return p * np.array([1.0, -1.0, -1.0, -1.0])


def _turn(x: Array, y: Array) -> Array:
    """Return the quaternion of the rotation vector (x, y, 0)."""
    return _exponential(np.stack((x, y, np.zeros_like(x)), axis=-1))


def _exponential(vector: Array) -> Array:
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.concatenate((np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / math.pi) * vector), axis=-1)


def _logarithm(p: Array) -> Array:
    """Return the rotation vector (..., 3) of a quaternion; its angle is at most half a turn."""
    p = np.where(p[..., :1] < 0.0, -p, p)
    size = np.linalg.norm(p[..., 1:], axis=-1, keepdims=True)
    return 2.0 * np.arctan2(size, p[..., :1]) / np.maximum(size, 1e-300) * p[..., 1:]


def _tangent(p: Array) -> Array:
    w, x, y, z = (p[..., i] for i in range(4))
    return np.stack((2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)), axis=-1)


#: Largest force at the tip [N], and as a multiple of EI / L^2 of the innermost tube (L: its length past the plate).
MAX_FORCE_N, MAX_RELATIVE_FORCE = 0.5, 20.0
#: One of so many solutions is checked for minimal energy; one of so many is compared with the exact rod.
ENERGY_CHECK_EVERY, BRANCH_CHECK_EVERY = 4, 25
#: Largest steps in which the exact rod moves from rest: rotation [rad], and fraction of the load.
REFERENCE_TURN_RAD, REFERENCE_LOAD_SHARE = 0.03, 0.02
#: Tips further apart than this are different shapes [m]; near a fold the error of the paper's sub-links is up to 3 mm.
OTHER_SHAPE_M = 5e-3


class TubeRow(NamedTuple):
    """Published tube, which is straight from its base and curved up to its end."""

    length: float  #: total length [m]
    curved: float  #: length of the curved part [m]
    bending: float  #: bending stiffness EI [N m^2]
    ratio: float  #: ratio EI / GJ of bending to torsional stiffness
    curvature: float  #: curvature of the curved part [1/m]


def annulus(modulus: float, shear: float, outer: float, inner: float) -> tuple[float, float]:
    """Return EI [N m^2] and EI / GJ of a tube from its elastic moduli [Pa] and its diameters [m]."""
    return modulus * math.pi / 64.0 * (outer**4 - inner**4), 0.5 * modulus / shear


#: Published robots with three tubes, innermost tube first.
PUBLISHED_ROBOTS: Mapping[str, tuple[TubeRow, ...]] = {
    # Khadem, Da Cruz, Bergeles, "Force/Velocity Manipulability Analysis for 3D Continuum Robots", IROS 2018,
    # doi 10.1109/IROS.2018.8593874: values l, l_k, E, I, G, J and U_x of the code published with that paper.
    "khadem": (
        TubeRow(0.431, 0.103, 6.4359738368e10 * 0.0601e-12, 1.2847, 21.3),
        TubeRow(0.332, 0.113, 5.2548578304e10 * 0.3267e-12, 1.2246, 13.108),
        TubeRow(0.174, 0.134, 4.7163091968e10 * 0.8432e-12, 0.7918, 3.5),
    ),
    # Grassmann, Modes, Burgner-Kahrs, "Learning the Forward and Inverse Kinematics of a 6-DOF Concentric Tube Continuum
    # Robot in SE(3)", IROS 2018: lengths, diameters and curvatures as listed in the code of K. Iyengar's
    # reinforcement-learning environment (system_1); E = 50 GPa and G = 23 GPa.
    "grassmann": (
        TubeRow(0.370, 0.045, *annulus(50e9, 23e9, 0.4e-3, 0.3e-3), 15.8),
        TubeRow(0.305, 0.100, *annulus(50e9, 23e9, 0.9e-3, 0.7e-3), 9.27),
        TubeRow(0.170, 0.100, *annulus(50e9, 23e9, 1.5e-3, 1.2e-3), 4.37),
    ),
    # Tubes of the RViM laboratory, King's College London, in the same list (system_2); E = 75 GPa, G = 25 GPa.
    "rvim": (
        TubeRow(0.309, 0.145, *annulus(75e9, 25e9, 1.1e-3, 0.7e-3), 13.52),
        TubeRow(0.275, 0.114, *annulus(75e9, 25e9, 1.8e-3, 1.4e-3), 11.68),
        TubeRow(0.173, 0.173, *annulus(75e9, 25e9, 2.39e-3, 1.83e-3), 10.8),
    ),
    # Boyer et al., "On High Performance Control of Concentric Tube Continuum Robots Through Parsimonious Calibration",
    # RA-L 2024, doi 10.1109/LRA.2024.3455906: the preset `three_tubes`.
    "boyer": (
        TubeRow(0.463, 0.05, 0.0072266, 1.3, 10.0),
        TubeRow(0.3305, 0.05, 0.0102783, 1.3, 5.0),
        TubeRow(0.199, 0.05, 0.0355595, 1.3, 7.0),
    ),
}

#: Kinds of robots: a number of random tubes, or a published robot.
ROBOT_KINDS: tuple[int | str, ...] = (2, 3, 4, *PUBLISHED_ROBOTS)


class Pose(NamedTuple):
    """Test case of the solver: robot, joint positions and load."""

    kind: str
    robot: Robot
    joints: Array  #: (n,) [rad or m]
    wrench: Array  #: (6,) [N, N m]


def published(name: str, ratio: float | None = None) -> Robot:
    """Return a robot of `PUBLISHED_ROBOTS`, with its published EI / GJ or with `ratio`."""
    return robot_of(name, PUBLISHED_ROBOTS[name], ratio)


def draw(seed: int, force: float = MAX_FORCE_N) -> Iterator[Pose]:
    """Yield robots at random valid poses under forces up to `force` [N], all kinds in turn, without an end."""
    rng = np.random.default_rng(seed)
    while True:
        for kind in ROBOT_KINDS:
            ratio = float(rng.uniform(1.0, 2.0))
            if isinstance(kind, str):
                robot = published(kind, ratio if rng.random() < 0.75 else None)
            else:
                robot = robot_of(f"{kind} random tubes", _random_rows(kind, rng), ratio)
            joints = _random_joints(robot, rng)
            direction = rng.normal(size=3)
            wrench = np.zeros(6)
            # Thin tubes get less force: at this limit any tube bends over completely.
            reach = float(robot.tube_poses(joints)[1][0]) + robot.tubes[0].length
            limit = min(force, MAX_RELATIVE_FORCE * robot.tubes[0].bending_stiffness / reach**2) if force > 0.0 else 0.0
            wrench[:3] = direction / np.linalg.norm(direction) * rng.uniform(0.0, 1.0) * limit
            yield Pose(robot.name, robot, joints, wrench)


def solver(poses: int = 10_000, seed: int = 0, done: Callable[[float], None] = lambda _: None) -> dict[str, Any]:
    """Solve random unloaded poses and random loaded poses with the paper's integrator, and return the results."""
    return {
        "unloaded": solve_random_poses(poses, seed, 0.0, lambda part: done(0.5 * part)),
        "loaded": solve_random_poses(poses, seed, MAX_FORCE_N, lambda part: done(0.5 + 0.5 * part)),
    }


def solve_random_poses(
    poses: int, seed: int, force: float, done: Callable[[float], None] = lambda _: None
) -> dict[str, Any]:
    """Solve `poses` random poses without a warm start.

    For some poses the exact rod moves from rest in small steps. `other_branch` counts poses at which the rod reaches
    another shape. `snapped` counts poses for which the rod snaps on the path or has no solution; such poses are not
    compared.
    """
    failed, unstable, checked, compared, other, snapped = 0, 0, 0, 0, 0, 0
    times, worst = np.empty(poses), 0.0
    kinds: dict[str, int] = {}
    warm: set[int] = set()
    source = draw(seed, force)
    for index in range(poses):
        pose = next(source)
        done(index / poses)
        model = Statics(pose.robot)
        if len(pose.robot.tubes) not in warm:  # compile or load the code before the first timing
            warm.add(len(pose.robot.tubes))
            model.solve(pose.joints, np.zeros(6))
        start = time.perf_counter()
        found = _solved(model, pose)
        times[index] = time.perf_counter() - start
        if found is None:
            failed += 1
            kinds[pose.kind] = kinds.get(pose.kind, 0) + 1
            continue
        worst = max(worst, model.residual(found))
        if index % ENERGY_CHECK_EVERY == 0:
            checked += 1
            unstable += lowest(pose.robot, found) < -ZERO_EIGENVALUE
        if index % BRANCH_CHECK_EVERY == 0:
            rod, calm = continued_from_rest(pose)
            if rod is None or not calm:
                snapped += 1
            else:
                compared += 1
                other += float(np.linalg.norm(rod.tip - found.tip)) > OTHER_SHAPE_M
    return {
        "poses": poses, "failed": failed, "failed_of": kinds,
        "energy_checked": checked, "unstable": unstable,
        "branch_compared": compared, "other_branch": other, "snapped": snapped,
        "largest_residual": float(f"{worst:.2g}"),
        "cold_solve_ms": {
            "median": round(1e3 * float(np.median(times)), 2), "mean": round(1e3 * float(times.mean()), 2),
            "p99": round(1e3 * float(np.percentile(times, 99)), 1), "max": round(1e3 * float(times.max()), 1),
        },
    }  # fmt: skip


def continued_from_rest(pose: Pose) -> tuple[Rod | None, bool]:
    """Rotate the exact rod from aligned tubes in small steps, then load it; return it and whether no step snapped."""
    exact, robot = ExactRod(pose.robot, step=0.004), pose.robot
    alpha, beta = robot.tube_poses(pose.joints)
    turns = np.array([math.remainder(angle - alpha[-1], math.tau) for angle in alpha])
    rod, calm = None, True
    path = [(part, 0.0) for part in np.linspace(0.0, 1.0, 2 + int(np.abs(turns).max() / REFERENCE_TURN_RAD))]
    if pose.wrench.any():
        path += [(1.0, part) for part in np.linspace(0.0, 1.0, 1 + round(1.0 / REFERENCE_LOAD_SHARE))[1:]]
    before = np.zeros(3)
    for turned, loaded in path:
        try:
            now = exact.solve_tubes(alpha[-1] + turned * turns, beta, loaded * pose.wrench, rod)
        except NoSolution:
            return None, False
        moved = now.tip - (before if rod is None else rod.tip)
        # In one step a snap moves the tip much further than the steps before and after.
        calm = calm and (rod is None or float(np.linalg.norm(moved)) < 0.1 * robot.tubes[0].length)
        before, rod = now.tip, now
    return rod, calm and rod is not None and exact.stability(pose.joints, pose.wrench, rod) > 0.0


def _solved(model: Statics, pose: Pose) -> Solution | None:
    try:
        return model.solve(pose.joints, pose.wrench)
    except NoSolution:
        return None


def robot_of(name: str, rows: tuple[TubeRow, ...], ratio: float | None) -> Robot:
    """Return a robot in which every tube rotates and translates independently."""
    tubes, joints = list[Tube](), list[Joint]()
    for i, row in enumerate(rows):
        straight = row.length - row.curved
        curve = Section(row.curved, (row.curvature, 0.0))
        sections = (Section(straight), curve) if straight > 1e-9 else (curve,)
        inner = 0.4e-3 + 0.6e-3 * i  # arbitrary diameters with which each tube fits into the next one
        gj = row.bending / (row.ratio if ratio is None else ratio)
        tubes.append(Tube(f"tube{i}", sections, row.bending, 0.3, inner + 0.5e-3, inner, gj))
        joints += [Joint(f"turn{i}", i, "rotation"), Joint(f"slide{i}", i, "translation")]
    return Robot(name, tuple(tubes), tuple(joints))


def _random_rows(count: int, rng: np.random.Generator) -> tuple[TubeRow, ...]:
    """Return random realistic tubes, innermost first: an outer tube is shorter, stiffer and mostly less curved."""
    rows = list[TubeRow]()
    bending, straight = float(rng.uniform(0.004, 0.02)), 0.04
    for i in range(count):
        curved = float(rng.uniform(0.04, 0.15))
        rows.append(TubeRow(0.0, curved, bending, 1.0, float(rng.uniform(2.0, 20.0)) / (1.0 + 0.7 * i)))
        bending *= float(rng.uniform(1.2, 3.5))
    for i in range(count - 1, -1, -1):  # from the outermost tube to the innermost
        straight += float(rng.uniform(0.02, 0.08))
        rows[i] = rows[i]._replace(length=straight + rows[i].curved)
        straight = rows[i].length
    return tuple(rows)


def _random_joints(robot: Robot, rng: np.random.Generator) -> Array:
    """Return random valid joints (n,); each tube ends at least 5 mm beyond the end of the tube around it."""
    q = len(robot.tubes)
    joints = np.empty(2 * q)
    joints[0::2] = rng.uniform(-math.pi, math.pi, q)
    start, end = 0.0, 0.0
    for i in range(q - 1, -1, -1):
        length = robot.tubes[i].length
        start = float(rng.uniform(min(end + 0.005 - length, start), start))
        end = start + length
        joints[2 * i + 1] = start
    return joints
