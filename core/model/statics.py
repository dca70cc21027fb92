"""Solver of the robot's shape under load: Newton's method, then the derivatives J and C of the tip, eq. (20).

The unknowns at the plate are the torsion u_iz of every tube and the moment M(0). The end conditions are u_iz = 0 at
each tube's distal end (the innermost tube carries the axial part of a tip moment) and M = the tip moment. One pass
along the tubes gives the end conditions and their derivatives for the Newton step. With the implicit function theorem
these derivatives also give the change of the unknowns with joints and load. J (derivative by the joints) and C (by the
load) include this change, so they are the derivatives of the *solved* tip. The determinant of the end conditions'
derivative by the unknowns is the margin of stability, `Solution.stability`.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from core.errors import DescriptionError, NoSolution, NotFinite
from core.model.newton import COLD_STEP_RAD, RESIDUAL_TOLERANCE, WARM_STEP_RAD, newton
from core.model.propagation import FIXED_ROWS, FRAME_ROWS, INTEGRATORS, Scheme, propagate, repeat
from core.model.relaxation import base_unknowns, cut, negative_directions, relax
from core.model.solution import Solution, at_rest
from core.robot.robot import Array, Robot, positive

__all__ = [
    "DEFAULT_SUBLINKS_M",
    "PAPER_SUBLINK_M",
    "RESIDUAL_TOLERANCE",
    "Integrator",
    "Solution",
    "Statics",
    "suitable_integrator",
]

Integrator = Literal["paper", "fourth_order"]

#: Length of a sub-link in the paper [m].
PAPER_SUBLINK_M = 0.010
#: Default length of a sub-link by integrator [m].
DEFAULT_SUBLINKS_M = {"paper": PAPER_SUBLINK_M, "fourth_order": 0.030}
#: Largest bend of a sub-link for the paper's integrator [rad]: the relative error of J and C is about a quarter of the
#: bend squared.
MAX_SUBLINK_BEND_RAD = 0.08
#: Largest rotation of a tube [rad], and largest fraction of the load, in one continuation step.
MAX_TURN_RAD, MAX_LOAD_SHARE = 0.5, 0.25
#: Largest mismatch between forward and backward prediction of one continuation step [rad over the whole length].
MAX_PREDICTION_MISMATCH_RAD = 0.25
#: Smallest continuation step as a fraction of the path. Where a smaller step would be needed, the tubes snap.
MIN_STEP_SHARE = 1e-3
#: Largest number of steps of one continuation, including rejected steps.
MAX_STEPS = 200
#: Distances beyond a snap, as fractions of the path, at which `relaxation` tries to find the shape after the snap.
RELEASE_SHARES = (1e-3, 2e-2, 0.2)
#: Largest number of snaps that one continuation follows.
MAX_SNAPS = 4
#: Element lengths of a relaxation [m], tried in this order until one leads to a stable shape.
RELAXATION_ELEMENTS_M = (0.02, 0.005)
#: Largest distance between cross-sections in the count of negative directions [m].
SECTION_SPACING_M = 0.005
#: Two solutions are the same shape when their tips are closer than this [m].
SAME_TIP_M = 1e-6


@dataclass(frozen=True)
class Statics:
    """Model of one robot's shape under load, with one integrator."""

    robot: Robot
    sublink: float | None = None  #: length of a sub-link [m]; None: the default of the integrator
    integrator: Integrator = "paper"

    def __post_init__(self) -> None:
        if self.integrator not in INTEGRATORS:
            raise DescriptionError(f"integrator '{self.integrator}' is unknown; choose {' or '.join(INTEGRATORS)}")
        if self.sublink is not None:
            positive("sublink", self.sublink, "m")

    def solve(
        self, joints: Array, wrench: Array, near: Solution | None = None, contact: float | None = None
    ) -> Solution:
        """Solve the shape under a load.

        Args:
            joints: positions (n,) [rad or m], in the order of `robot.joints`.
            wrench: force and moment (6,), world frame [N, N m]; the moment acts at the tip.
            near: a nearby solution; the solve follows its branch to the new pose and load. None: the solve follows the
                shape from rest (aligned, unloaded tubes) and returns a stable shape.
            contact: arc length from the plate at which the force acts [m]; None for the tip.

        Raises:
            PoseError: the pose is invalid, or `contact` is beyond the tubes.
            NotFinite: the wrench is not finite.
            NoSolution: no solution was reached.

        """
        position = math.inf if contact is None else contact
        if near is not None and joints.shape == (len(self.robot.joints),) and wrench.shape == (6,):
            found = Solution(np.empty_like(near.numbers))
            if newton(
                *self._fixed, joints, wrench, near.numbers, position, 1, WARM_STEP_RAD, *self._widths, found.numbers
            ):
                return found
        self._check(joints, wrench, contact)
        solution = self._follow(near, joints, wrench, position) if near is not None else None
        if solution is None:
            solution = self._cold(joints, wrench, position)
        if solution is not None:
            return solution
        raise NoSolution(
            f"no shape found for {dict(zip(self.robot.joint_names, joints.tolist(), strict=True))}"
            f" under {wrench[:3].tolist()} N, {wrench[3:].tolist()} N m; is the load within reach of the tubes?"
        )

    def shape(self, solution: Solution) -> Array:
        """Return cross-sections from the plate to the tip (m, 16 + 2q).

        A row contains arc length [m], the frame by rows (9), position (3) [m], theta_i (q) [rad], u_iz (q) [1/m] and
        the moment M (3) [N m]. All vectors are in the world frame.
        """
        path, _ = self._pass(solution)
        path[:, 10:13] += self.robot.base.position
        return path

    def negative_directions(self, solution: Solution) -> int:
        """Count the independent directions in which the elastic energy falls: 0 when the shape is stable.

        A cold solve (without `near`) includes this check; a warm solve checks only the sign of the stability margin. A
        moment at the tip has no potential energy. Under such a moment a count of 0 still means stable, but a larger
        count does not prove instability.
        """
        return negative_directions(
            self.robot, solution.joints, solution.wrench, solution.contact, self._sections(solution)
        )

    def residual(self, solution: Solution) -> float:
        """Recompute a solution and return the largest violation of its end conditions [1/m or N m]."""
        _, state = self._pass(solution)
        q = len(self.robot.tubes)
        twist = self.robot.layout.stiffness[0, 1] / self.robot.layout.stiffness[0, 0]
        torsion = state[12 + q : 12 + 2 * q].copy()
        torsion[0] -= twist * (state[2:9:3] @ solution.wrench[3:])
        return float(max(np.abs(torsion).max(), np.abs(state[15 + 2 * q :] - solution.wrench[3:]).max()))

    def repeat_pass(self, solution: Solution, times: int, with_derivatives: bool) -> None:
        """Integrate along the tubes `times` times, to measure the time of the arithmetic alone."""
        alpha, beta = self.robot.tube_poses(solution.joints)
        tubes, columns = self._widths
        repeat(
            self.robot.layout, self._scheme, alpha, beta, solution.wrench[:3].copy(), solution.contact,
            solution.unknowns, tubes, columns if with_derivatives else (), times,
        )  # fmt: skip

    def _pass(self, solution: Solution) -> tuple[Array, Array]:
        """Return cross-sections (m, 16 + 2q), relative to the plate, and the state at the tip."""
        q = len(self.robot.tubes)
        alpha, beta = self.robot.tube_poses(solution.joints)
        length = float(beta[0]) + self.robot.tubes[0].length
        path = np.empty((int(length / self._scheme.sublink) + 4 + int(self.robot.layout.counts.sum()), 16 + 2 * q))
        state, rates = np.empty(18 + 2 * q), np.empty(0)
        passed = propagate(
            self.robot.layout, self._scheme, alpha, beta, solution.wrench[:3].copy(), solution.contact,
            solution.unknowns, (0.0,) * q, (), state, rates, path,
        )  # fmt: skip
        return path[:passed], state

    def _sections(self, solution: Solution) -> Array:
        """Return the states (m, 16 + 2q) of m closely spaced cross-sections; positions are relative to the plate."""
        alpha, beta = self.robot.tube_poses(solution.joints)
        tubes, columns = self._widths
        q, length = len(tubes), float(beta[0]) + self.robot.tubes[0].length
        scheme = Scheme(self._scheme.order, min(self._scheme.sublink, SECTION_SPACING_M))
        path = np.empty((int(length / scheme.sublink) + 4 + int(self.robot.layout.counts.sum()), 16 + 2 * q))
        # Derivative columns are computed but not used: another number of columns would need a separate compilation.
        state, rates = np.empty(18 + 2 * q), np.empty((FRAME_ROWS + 2 * q + FIXED_ROWS) * len(columns))
        passed = propagate(
            self.robot.layout, scheme, alpha, beta, solution.wrench, solution.contact, solution.unknowns,
            tubes, columns, state, rates, path,
        )  # fmt: skip
        return path[:passed]

    def _cold(self, joints: Array, wrench: Array, contact: float) -> Solution | None:
        """Return the stable shape that the robot reaches from rest; None when no shape is reached.

        Newton's method mostly finds the same shape directly; J and C are then those of Newton's last pass.
        """
        found = self._from_rest(joints, wrench, contact)
        if found is None:
            return None
        rest = at_rest(joints, contact, len(self.robot.tubes))
        direct = self._newton(joints, wrench, rest, contact, careful=0)
        if direct is not None and np.linalg.norm(direct.tip - found.tip) < SAME_TIP_M:
            found = direct
        if self.negative_directions(found) == 0:
            return found
        # Continuation and Newton's method may find an unstable equilibrium, such as a straight tube under axial load.
        relaxed = self._release(found, joints, wrench, contact)
        # A moment at the tip has no potential energy: a shape may then be stable in spite of negative directions.
        return found if relaxed is None and wrench[3:].any() and found.stability > 0.0 else relaxed

    def _from_rest(self, joints: Array, wrench: Array, contact: float) -> Solution | None:
        """Follow the shape from aligned, unloaded tubes: turn each tube by at most half a turn, then apply the load."""
        aligned, short, no_load = joints.copy(), joints.copy(), np.zeros(6)
        outermost = float(self.robot.tube_poses(joints)[0][-1])
        for j, joint in enumerate(self.robot.joints):
            if joint.motion == "rotation":
                aligned[j] = outermost
                short[j] = outermost + math.remainder(joints[j] - outermost, math.tau)
        rest = at_rest(aligned, contact, len(self.robot.tubes))
        at = self._newton(aligned, no_load, rest, contact, careful=0)
        if at is None or self.negative_directions(at) > 0:
            at = self._release(None, aligned, no_load, contact)
        for load in (no_load, wrench):
            at = self._follow(at, short, load, contact) if at is not None else None
        if at is not None:
            at.joints[:] = joints  # a whole turn of a tube does not change the shape
        return at

    def _follow(
        self, start: Solution, joints: Array, wrench: Array, contact: float, snaps: int = MAX_SNAPS
    ) -> Solution | None:
        """Follow the branch of `start` to a pose and load, along the straight line between both, in short steps.

        Where the branch ends, the tubes snap to another stable shape, and the continuation follows that shape, for at
        most `snaps` snaps.
        """
        moved, loaded = joints - start.joints, wrench - start.wrench
        longest = 1.0 / max(1.0, np.abs(moved).max(initial=0.0) / MAX_TURN_RAD, float(loaded.any()) / MAX_LOAD_SHARE)
        at, done, step = start, 0.0, longest
        for _ in range(MAX_STEPS):
            if done == 1.0:
                return at
            to = min(1.0, done + step)
            pose, load = joints - (1.0 - to) * moved, wrench - (1.0 - to) * loaded
            found = self._newton(pose, load, at, contact, careful=1)
            if found is not None and self._mismatch(at, found) < MAX_PREDICTION_MISMATCH_RAD:
                at, done, step = found, to, min(2.0 * step, longest)
            elif step > MIN_STEP_SHARE:
                step *= 0.25
            else:
                break
        if snaps == 0:
            return None
        # The elements of `relaxation` snap slightly earlier or later than the sub-links: relax beyond the branch's end.
        for beyond in RELEASE_SHARES:
            to = done + beyond
            pose, load = joints - (1.0 - to) * moved, wrench - (1.0 - to) * loaded
            if to <= 1.0 or self.robot.is_valid_pose(pose):
                found = self._release(at, pose, load, contact)
                if found is not None:
                    return self._follow(found, joints, wrench, contact, snaps - 1)
        return None

    def _mismatch(self, here: Solution, there: Solution) -> float:
        """Return the error with which each of two solutions predicts the other [rad over the length], at first order.

        The error is large if the solutions are on different branches.
        """
        move = np.concatenate((there.joints - here.joints, there.wrench - here.wrench))
        change = there.unknowns - here.unknowns
        q = len(self.robot.tubes)
        length = float(self.robot.tube_poses(there.joints)[1][0]) + self.robot.tubes[0].length
        misses = np.abs([change - here.sensitivity @ move, change - there.sensitivity @ move]).max(axis=0)
        misses[q:] /= self.robot.layout.stiffness[0, 0]
        return length * float(misses.max())

    def _release(self, near: Solution | None, joints: Array, wrench: Array, contact: float) -> Solution | None:
        """Relax the tubes from `near` (None: untwisted tubes); return the stable shape that they reach, or None."""
        force = np.append(wrench[:3], np.zeros(3))
        if np.linalg.norm(force) * RELAXATION_ELEMENTS_M[-1] ** 2 > self.robot.layout.stiffness[0, 0]:
            return None  # the force bends the innermost tube strongly within one element and one sub-link
        for longest in RELAXATION_ELEMENTS_M:
            chain = cut(self.robot, joints, wrench[:3], contact, longest)
            theta, moment = np.tile(chain.alpha, (chain.ends.size, 1)), np.zeros((chain.ends.size - 1, 2))
            if near is not None:
                path, q = self._sections(near), len(self.robot.tubes)
                theta += _at(path, path[:, 13 : 13 + q], chain.ends) - self.robot.tube_poses(near.joints)[0]
                frames, moments = path[:, 1:10].reshape(-1, 3, 3), path[:, 13 + 2 * q :]
                bending = np.einsum("mji,mj->mi", frames, moments)[:, :2]
                moment = _at(path, bending, 0.5 * (chain.ends[1:] + chain.ends[:-1]))
            relaxed = relax(chain, theta, moment)
            if relaxed is None:
                continue
            guess = at_rest(joints, contact, len(self.robot.tubes))
            guess.wrench[:] = force
            guess.unknowns[:] = base_unknowns(self.robot, chain, *relaxed)
            found = self._newton(joints, force, guess, contact, careful=0)
            if found is not None and self.negative_directions(found) == 0:
                return self._follow(found, joints, wrench, contact, snaps=0) if wrench[3:].any() else found
        return None

    def _newton(self, joints: Array, wrench: Array, near: Solution, contact: float, careful: int) -> Solution | None:
        close = WARM_STEP_RAD if careful else COLD_STEP_RAD
        found = Solution(np.empty_like(near.numbers))
        arguments = (*self._fixed, joints, wrench, near.numbers, contact, careful, close, *self._widths, found.numbers)
        return found if newton(*arguments) else None

    def _check(self, joints: Array, wrench: Array, contact: float | None) -> None:
        self.robot.check_pose(joints)
        if wrench.shape != (6,) or not np.isfinite(wrench).all():
            raise NotFinite(f"tip wrench {wrench.tolist()} [N, N m] must be six finite numbers")
        self.robot.check_contact(joints, contact)

    @property
    def step(self) -> float:
        """Length of a sub-link [m]."""
        return self._scheme.sublink

    @cached_property
    def compiled_arguments(self) -> tuple[Array, int, float, tuple[float, ...], tuple[float, ...]]:
        """Arguments of `core.model.newton` that are equal in all solves of this model: `_fixed`, then `_widths`."""
        return (*self._fixed, *self._widths)

    @cached_property
    def outer_radii(self) -> Array:
        """Outer radii of the tubes (q,) [m], the innermost first."""
        return np.array([0.5 * tube.outer_diameter for tube in self.robot.tubes])

    @cached_property
    def max_sections(self) -> int:
        """Largest number of cross-sections that a pass along the tubes records."""
        longest = max(tube.length for tube in self.robot.tubes)
        return int(longest / self._scheme.sublink) + 4 + 2 * int(self.robot.layout.counts.sum())

    @cached_property
    def _scheme(self) -> Scheme:
        return Scheme(INTEGRATORS[self.integrator], self.sublink or DEFAULT_SUBLINKS_M[self.integrator])

    @cached_property
    def _fixed(self) -> tuple[Array, int, float]:
        """First arguments of `core.model.newton`: the packed robot, the integrator's order, the sub-link length [m]."""
        return self.robot.packed, self._scheme.order, self._scheme.sublink

    @cached_property
    def _widths(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Two tuples whose lengths are constants to the compiler: the numbers of tubes and of derivative columns.

        The number of columns is rounded up to a multiple of 4, which fills whole vector registers.
        """
        q, n = len(self.robot.tubes), len(self.robot.joints)
        return (0.0,) * q, (0.0,) * (-(-(q + 3 + n + 3) // 4) * 4)


def suitable_integrator(robot: Robot, sublink: float = PAPER_SUBLINK_M) -> Integrator:
    """Return `paper`, or `fourth_order` if a curve bends a sub-link [m] by more than `MAX_SUBLINK_BEND_RAD`."""
    return "paper" if sublink_bend(robot, sublink) <= MAX_SUBLINK_BEND_RAD else "fourth_order"


def sublink_bend(robot: Robot, sublink: float = PAPER_SUBLINK_M) -> float:
    """Return the bend of a sub-link of length `sublink` [m] in the most curved section of all tubes [rad]."""
    return sublink * max(math.hypot(*section.curvature) for tube in robot.tubes for section in tube.sections)


def _at(path: Array, values: Array, lengths: Array) -> Array:
    """Interpolate `values` (m, k), given at the arc lengths of `path`, at other arc `lengths`; return (len, k)."""
    columns: list[Array] = [np.interp(lengths, path[:, 0], column) for column in values.T]
    return np.column_stack(columns)
