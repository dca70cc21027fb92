"""Strength of a design: whether its tubes snap, which tip force they bear, and how much they weigh.

**Snap number.** Consider two tubes with curvatures u1 and u2 and equal curved lengths L. Let l be the length of a
single straight tube that twists as much as the straight parts of both tubes together. With k^2 = (1 + nu) u1 u2, this
pair rotates without a snap if

    k L < pi / 2   and   S = l k tan(k L) < 1   (Dupont et al. 2010; Ha, Park, Dupont 2016).

S is the snap number. For any tubes the snap number is 1 - D / D0. D is the determinant of the derivative of the end
torsion by the base torsion, at the worst alignment of the tubes' curves (each parallel or opposite, without torsion).
D0 is the same determinant without the twist of the tubes before their curves overlap. For the pair above the result is
exactly S. The margin under load is `Solution.stability`, the same determinant at the loaded shape.

**Largest tip force.** A force F across a robot that reaches L beyond the plate bends the robot with a moment of at most
F L. The largest force is the smallest of three bounds:

* a base sensor's force:  F = 0.6 force range
* a base sensor's moment: F = 0.6 moment range  sum(EI) / (max(EI) L): tubes share the moment in proportion to EI;
  F = 0.9 moment range / L for one sensor under the whole robot, in which the forces between the tubes cancel
* the innermost tube alone: F = EI (strain limit / radius - curvature imposed by the tubes) / L

The rest of each sensor range is reserved for the forces and moments between the tubes, which the sensors also measure.
In the paper's robot the moments between the tubes take 90 N mm of the range of 250 N mm.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np

from core.errors import DescriptionError
from core.robot.limits import ForceBound, JointLimit
from core.robot.robot import Array, Robot

#: Number of grid positions along the travel of each translation at which a design is evaluated.
GRID_POSES = 9


def snap_number(robot: Robot, joints: Array) -> float:
    """Return the snap number at the translations of `joints` (n,): the largest S over parallel and opposite tubes.

    The value is 0 if the tubes cannot store torsion, and below 1 if they do not snap. It is infinite if they snap even
    without straight lengths.

    Raises:
        PoseError: the pose is invalid.
        DescriptionError: a tube is not curved in one plane.

    """
    robot.check_pose(joints)
    beta = robot.tube_poses(joints)[1]
    pieces = _pieces(robot, beta)
    worst = 0.0
    for signs in itertools.product((1.0, -1.0), repeat=len(robot.tubes) - 1):
        flexible, stiff = (_determinant(robot, beta, pieces, np.array((1.0, *signs)), bare) for bare in (False, True))
        worst = max(worst, 1.0 - flexible / stiff if stiff > 0.0 else math.inf)
    return worst


def design_snap_number(robot: Robot, lower: Array, upper: Array) -> float:
    """Return the largest snap number within the travel (n,) of the joints, on a grid of the translations.

    Raises:
        DescriptionError: a tube is not curved in one plane, or no pose in the travel is valid.

    """
    travels: list[Array] = [
        np.linspace(low, high, GRID_POSES) if joint.motion == "translation" else np.zeros(1)
        for joint, low, high in zip(robot.joints, lower, upper, strict=True)
    ]
    numbers: list[float] = []
    for pose in itertools.product(*travels):
        joints = np.array(pose, dtype=np.float64)
        if robot.is_valid_pose(joints):
            numbers.append(snap_number(robot, joints))
    if not numbers:
        raise DescriptionError(f"robot '{robot.name}': no pose within the travel of its joints is valid")
    return max(numbers)


def _pieces(robot: Robot, beta: Array) -> list[tuple[float, float, Array]]:
    """Return start, end and signed curvatures of the tubes (q,) for each piece beyond the plate; NaN: tube absent."""
    borders = {0.0}
    signed: list[list[tuple[float, float]]] = []
    for tube, start in zip(robot.tubes, beta, strict=True):
        axis, end = None, float(start)
        ends: list[tuple[float, float]] = []
        for section in tube.sections:
            end += section.length
            x, y = section.curvature
            size = math.hypot(x, y)
            if size > 0.0 and axis is None:
                axis = (x / size, y / size)
            along = 0.0 if axis is None else x * axis[0] + y * axis[1]
            if axis is not None and abs(x * axis[1] - y * axis[0]) > 1e-9 * max(1.0, size):
                raise DescriptionError(f"tube '{tube.name}' is not curved in one plane; it has no snap number")
            ends.append((end, along))
            if end > 0.0:
                borders.add(end)
        signed.append(ends)
    order = sorted(borders)
    return [
        (
            start,
            end,
            np.array([next((along for distal, along in ends if distal > start + 1e-12), math.nan) for ends in signed]),
        )
        for start, end in itertools.pairwise(order)
        if end > start + 1e-12
    ]


def _determinant(
    robot: Robot, beta: Array, pieces: list[tuple[float, float, Array]], signs: Array, bare: bool
) -> float:
    """Return the determinant of d end torsion / d base torsion; `bare` ignores the twist before the curves overlap."""
    q = len(robot.tubes)
    turn, twist = np.diag(-beta), np.eye(q)
    met = False
    for start, end, curvatures in pieces:
        present = np.flatnonzero(np.isfinite(curvatures))
        u = signs[present] * curvatures[present]
        stiffness = robot.layout.stiffness[present, 0]
        share = stiffness / stiffness.sum()
        if not met and np.count_nonzero(u) > 1:
            met = True
            if bare:
                turn[:] = 0.0
        rate = robot.layout.stiffness[present, 1] * u
        coupling = np.diag(rate * (share @ u)) - np.outer(rate, share * u)
        # turn'' = coupling turn
        length = end - start
        even, odd = np.eye(len(u)), length * np.eye(len(u))
        term = np.eye(len(u))
        for order in range(1, 30):
            term = term @ coupling * (length * length / ((2 * order - 1) * (2 * order)))
            even += term
            odd += term * (length / (2 * order + 1))
        turn[present], twist[present] = (
            even @ turn[present] + odd @ twist[present],
            coupling @ odd @ turn[present] + even @ twist[present],
        )
    return float(np.linalg.det(twist))


def straightened_strains(robot: Robot, lower: Array) -> Array:
    """Return the strain (q,) at each tube's surface where the guide straightens its curves.

    A curve is straightened if it enters the guide behind the plate at the lower ends `lower` (n,) of the travels.
    """
    strains, (_, beta) = np.zeros(len(robot.tubes)), robot.tube_poses(lower)
    for i, (tube, start) in enumerate(zip(robot.tubes, beta.tolist(), strict=True)):
        for section in tube.sections:
            if start < 0.0:
                strains[i] = max(strains[i], 0.5 * tube.outer_diameter * math.hypot(*section.curvature))
            start += section.length
    return strains


#: Largest fraction of a sensor's range that the load may use: for a sensor at a tube, and for a sensor under the whole
#: robot, which needs a reserve only for its offset and for moving weights.
LOAD_PART, WHOLE_LOAD_PART = 0.6, 0.9
#: Largest strain at a tube's surface under a tip force (no unit): with a reserve, nitinol and nylon recover from it.
MAX_STRAIN = 0.03
#: Ranges of the ATI Nano43 SI-18-0.25, the sensor of the paper's bench: force [N] and moment [N m].
NANO43_RANGES = (18.0, 0.25)


def force_bound(robot: Robot, joints: Sequence[JointLimit], ranges: tuple[float, float] = NANO43_RANGES) -> ForceBound:
    """Return the largest tip force [N] that tubes and sensors can bear; `ranges` are those of a sensor [N, N m]."""
    slide = next((k for k, joint in enumerate(robot.joints) if (joint.tube, joint.motion) == (0, "translation")), None)
    inner = robot.tubes[0]
    reach = inner.length + (inner.translation if slide is None else joints[slide].upper)
    stiffness = [tube.bending_stiffness for tube in robot.tubes]
    curved = [max(math.hypot(*section.curvature) for section in tube.sections) for tube in robot.tubes]
    reserve = (
        min(MAX_STRAIN, inner.max_strain) / (0.5 * inner.outer_diameter) - curved[0] - max(curved[1:], default=0.0)
    )
    whole = robot.sensed == "robot"
    force, moment = ((WHOLE_LOAD_PART if whole else LOAD_PART) * each for each in ranges)
    largest_share = 1.0 if whole else max(stiffness) / sum(stiffness)
    bounds = (
        ForceBound(force, "the force range of a base sensor"),
        ForceBound(moment / (largest_share * reach), "the moment range of a base sensor"),
        ForceBound(inner.bending_stiffness * reserve / reach, f"the strain of tube '{inner.name}'"),
    )
    return min((bound for bound in bounds if bound.newton > 0.0), key=lambda bound: bound.newton)


def own_weight(robot: Robot, joints: Array) -> float:
    """Return the force at the tip [N], along gravity, equivalent to the tubes' own weight at `joints` (n,).

    At the end of a cantilever of length L, a distributed weight w(s) causes the same sag as the end force

        F = integral of w(s) s^2 (3 L - s) / (2 L^3) ds        (3/8 w L for one tube from the plate to the tip).

    The weight beyond a retracted tip, at s > L, counts with L^2 (3 s - L) / (2 L^3). The formula ignores curvature, and
    ignores that the inner tube is softer than the bundle. The resulting error is a few percent of a sag of half a
    millimetre.
    """
    tip, *_ = ends = robot.tube_ends(joints).tolist()
    if tip <= 0.0:
        return 0.0
    force = 0.0
    for tube, end in zip(robot.tubes, ends, strict=True):
        near, beyond = min(end, tip), max(end, tip)
        force += tube.weight * (tip * near**3 - 0.25 * near**4) / (2.0 * tip**3)
        force += tube.weight * (beyond - tip) * (1.5 * (beyond + tip) - tip) / (2.0 * tip)
    return force
