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
from core.model.relaxation import (
    ElementChain,
    base_unknowns,
    cut,
    negative_directions,
    precurvature,
    relax,
    settle,
    tip,
)
from core.model.solution import Solution, at_rest
from core.robot.robot import Array, Robot, positive

__all__ = [
    "PAPER_SUBLINK_M",
    "RESIDUAL_TOLERANCE",
    "Integrator",
    "Solution",
    "Statics",
    "suitable_integrator",
    "suitable_sublink",
]

Integrator = Literal["paper", "fourth_order"]

#: Length of a sub-link in the paper [m].
PAPER_SUBLINK_M = 0.010
#: Largest bend of a sub-link by precurvature [rad] with which the paper's integrator is used. The tip error is about
#: bend^2 / 6 of the curved length, and 0.05 % is the bound.
MAX_PAPER_BEND_RAD = 0.05
#: Fourth-order integrator: longest sub-link [m]; largest bend of a sub-link by precurvature and load together [rad];
#: and largest bend of the whole innermost tube by a load [rad]. The tip error is then below 0.05 mm or 0.05 % of the
#: length, which the test `test_sublinks` checks.
MAX_SUBLINK_M, MAX_SUBLINK_TURN_RAD, LOAD_BEND_RAD = 0.030, 0.45, 6.0
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
#: Element lengths of a relaxation under a moment [m], whose steps take longer.
MOTION_ELEMENTS_M = (0.02, 0.01)
#: Largest distance between a relaxed tip and the solution's, as a fraction of the length.
MAX_RELAXATION_ERROR = 0.05
#: Largest distance between cross-sections in the count of negative directions [m].
SECTION_SPACING_M = 0.005
#: Two solutions are the same shape when their tips are closer than this [m].
SAME_TIP_M = 1e-6


@dataclass(frozen=True)
class Statics:
    """Model of one robot's shape under load, with one integrator."""

    robot: Robot
    sublink: float | None = None  #: length of a sub-link [m]; None: 10 mm for `paper`, else `suitable_sublink`
    integrator: Integrator | None = None  #: None: `suitable_integrator`

    def __post_init__(self) -> None:
        if self.integrator is not None and self.integrator not in INTEGRATORS:
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
            f" under {wrench[:3].tolist()} N, {wrench[3:].tolist()} N m; reduce the load, or check the tubes"
        )

    def shape(self, solution: Solution) -> Array:
        """Return cross-sections from the plate to the last tube end (m, 16 + 2q).

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

    def strains(self, solution: Solution) -> Array:
        """Return the largest bending strain (q,) at each tube's surface: its radius times the change of curvature."""
        q, path = len(self.robot.tubes), self._sections(solution)
        beta = self.robot.tube_poses(solution.joints)[1]
        path = path[np.append(np.diff(path[:, 0]) > 1e-9, True)]
        middle = 0.5 * (path[1:] + path[:-1])
        bend, free = precurvature(self.robot, beta, middle[:, 0])
        moment = np.einsum("mji,mj->mi", middle[:, 1:10].reshape(-1, 3, 3), middle[:, 13 + 2 * q :])[:, :2]
        cos, sin = np.cos(middle[:, 13 : 13 + q]), np.sin(middle[:, 13 : 13 + q])
        own = np.stack((cos * free[..., 0] - sin * free[..., 1], sin * free[..., 0] + cos * free[..., 1]), axis=-1)
        shared = (np.einsum("mi,mik->mk", bend, own) + moment) / bend.sum(axis=1)[:, None]
        change = np.linalg.norm(shared[:, None] - own, axis=2) * (bend > 0.0)
        return change.max(axis=0, initial=0.0) * self.outer_radii

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
            self.robot.layout, self._scheme, alpha, beta, solution.wrench, solution.contact,
            solution.unknowns, tubes, columns if with_derivatives else (), times,
        )  # fmt: skip

    def _pass(self, solution: Solution) -> tuple[Array, Array]:
        """Return cross-sections (m, 16 + 2q), relative to the plate, and the state at the tip."""
        q = len(self.robot.tubes)
        alpha, beta = self.robot.tube_poses(solution.joints)
        path = np.empty((self.max_sections, 16 + 2 * q))
        state, rates = np.empty(18 + 2 * q), np.empty(0)
        passed = propagate(
            self.robot.layout, self._scheme, alpha, beta, solution.wrench, solution.contact,
            solution.unknowns, (0.0,) * q, (), state, rates, path,
        )  # fmt: skip
        return path[:passed], state

    def _sections(self, solution: Solution) -> Array:
        """Return the states (m, 16 + 2q) of m closely spaced cross-sections; positions are relative to the plate."""
        alpha, beta = self.robot.tube_poses(solution.joints)
        tubes, columns = self._widths
        q, length = len(tubes), self._length(solution.joints)
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
            # The motion under a moment may end between two shapes: start from untwisted tubes under the whole moment.
            return self._release(None, joints, wrench, contact) if wrench[3:].any() else None
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
        misses = np.abs([change - here.sensitivity @ move, change - there.sensitivity @ move]).max(axis=0)
        misses[q:] /= self.robot.layout.stiffness[0, 0]
        return self._length(there.joints) * float(misses.max())

    def _length(self, joints: Array) -> float:
        """Return the arc length from the plate to the last tube end [m]."""
        return float(self.robot.tube_ends(joints).max())

    def _release(self, near: Solution | None, joints: Array, wrench: Array, contact: float) -> Solution | None:
        """Relax the tubes from `near` (None: untwisted tubes); return the stable shape that they reach, or None."""
        short, moment_size = RELAXATION_ELEMENTS_M[-1], float(np.linalg.norm(wrench[3:]))
        if max(np.linalg.norm(wrench[:3]) * short, moment_size) * short > self.robot.layout.stiffness[0, 0]:
            return None  # the load bends the innermost tube strongly within one element and one sub-link
        for longest in MOTION_ELEMENTS_M if moment_size else RELAXATION_ELEMENTS_M:
            chain = cut(self.robot, joints, wrench, contact, longest)
            theta, moment = np.tile(chain.alpha, (chain.ends.size, 1)), np.zeros((chain.ends.size - 1, 2))
            if near is not None:
                path, q = self._sections(near), len(self.robot.tubes)
                theta += _at(path, path[:, 13 : 13 + q], chain.ends) - self.robot.tube_poses(near.joints)[0]
                frames, moments = path[:, 1:10].reshape(-1, 3, 3), path[:, 13 + 2 * q :]
                bending = np.einsum("mji,mj->mi", frames, moments)[:, :2]
                moment = _at(path, bending, 0.5 * (chain.ends[1:] + chain.ends[:-1]))
            relaxed = (settle if wrench[3:].any() else relax)(chain, theta, moment)
            if relaxed is None:
                continue
            guess = at_rest(joints, contact, len(self.robot.tubes))
            guess.wrench[:] = wrench
            guess.unknowns[:] = base_unknowns(self.robot, chain, *relaxed)
            found = self._newton(joints, wrench, guess, contact, careful=0)
            if found is not None and (self.negative_directions(found) == 0 or self._is_same(found, chain, relaxed[0])):
                return found
        return None

    def _is_same(self, found: Solution, chain: ElementChain, k: Array) -> bool:
        """Return whether a solution under a moment is the shape at which the robot came to rest with curvatures `k`."""
        length = chain.ends[-1]
        apart = float(np.linalg.norm(found.tip - tip(self.robot, chain, k)))
        return bool(found.wrench[3:].any()) and found.stability > 0.0 and apart < MAX_RELAXATION_ERROR * length

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
    def used_integrator(self) -> Integrator:
        """Name of the integrator in use: `integrator`, or by default `suitable_integrator`."""
        return self.integrator or suitable_integrator(self.robot)

    @property
    def discretisation(self) -> str:
        """Human-readable integrator and length of its sub-links."""
        name = "the paper's" if self.used_integrator == "paper" else "fourth-order"
        return f"{name} integrator, sub-links of {1e3 * self.step:.3g} mm"

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
        default = PAPER_SUBLINK_M if self.used_integrator == "paper" else suitable_sublink(self.robot)
        return Scheme(INTEGRATORS[self.used_integrator], self.sublink or default)

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


def suitable_integrator(robot: Robot) -> Integrator:
    """Return `paper` if the robot names it and the bend of a sub-link is small enough, else `fourth_order`."""
    curvature = max(math.hypot(*section.curvature) for tube in robot.tubes for section in tube.sections)
    accurate = PAPER_SUBLINK_M * curvature <= MAX_PAPER_BEND_RAD
    return "paper" if robot.integrator == "paper" and accurate else "fourth_order"


def suitable_sublink(robot: Robot) -> float:
    """Return the sub-link length [m] of the fourth-order integrator with which the tip error is negligible.

    The sub-link is shorter for tubes with more precurvature, more bend by a load, or a larger ratio EI / GJ. Its length
    is a smooth function of the tubes' parameters, so that a fit can use difference quotients.
    """
    curvature = max(
        math.hypot(*section.curvature) * math.sqrt(max(1.0, tube.stiffness_ratio))
        for tube in robot.tubes
        for section in tube.sections
    )
    return min(MAX_SUBLINK_M, MAX_SUBLINK_TURN_RAD / math.hypot(curvature, LOAD_BEND_RAD / robot.tubes[0].length))


def _at(path: Array, values: Array, lengths: Array) -> Array:
    """Interpolate `values` (m, k), given at the arc lengths of `path`, at other arc `lengths`; return (len, k)."""
    columns: list[Array] = [np.interp(lengths, path[:, 0], column) for column in values.T]
    return np.column_stack(columns)
