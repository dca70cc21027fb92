"""The loaded model solved: base unknowns by Newton, then J and C of the solved problem, eq. (20).

Unknown at the plate are u_iz of every tube and M(0). Known at the far end: u_iz = 0 at each
tube's own end (the innermost carries the axial part of a tip moment) and M = the tip moment.
The derivative columns of the pass give the Newton step, and by the implicit function theorem the
way the unknowns themselves move with joints and load; J and C contain both parts, so that they
are the derivatives of the *solved* tip. The determinant of the same matrix is the margin of
elastic stability, see `stability`.
"""

import itertools
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from core.errors import DescriptionError, NoSolution, NotFinite
from core.model.newton import CLOSE, CLOSEST, TOLERANCE, newton
from core.model.propagation import INTEGRATORS, Scheme, propagate, repeat
from core.model.solution import Solution, at_rest
from core.robot.robot import Array, Robot, positive

__all__ = ["PAPER_SUBLINK", "SUBLINKS", "TOLERANCE", "Solution", "Statics"]

#: The paper's sub-link [m].
PAPER_SUBLINK = 0.010
#: Length of a sub-link unless another is asked for, by integrator [m].
SUBLINKS = {"paper": PAPER_SUBLINK, "fourth_order": 0.030}
#: Moves in so many steps are tried, one after the other, when the direct way fails.
INCREMENTS = (4, 16, 64)


@dataclass(frozen=True)
class Statics:
    """The loaded model of one robot, integrated one way."""

    robot: Robot
    sublink: float | None = None  #: [m]; None: `SUBLINKS`; the last of each link takes the remainder
    integrator: Literal["paper", "fourth_order"] = "paper"

    def __post_init__(self) -> None:
        if self.integrator not in INTEGRATORS:
            raise DescriptionError(f"integrator '{self.integrator}' is unknown; choose {' or '.join(INTEGRATORS)}")
        if self.sublink is not None:
            positive("sublink", self.sublink, "m")

    def solve(
        self, joints: Array, wrench: Array, near: Solution | None = None, contact: float | None = None
    ) -> Solution:
        """Shape under a load.

        Args:
            joints: positions (n,) [rad or m], in the order of `robot.joints`.
            wrench: force and moment (6,), world frame [N, N m]; the moment acts at the tip.
            near: a solution nearby, whose branch is followed; without it the load is applied
                in steps when the direct way fails.
            contact: arc length from the plate at which the force acts [m]; None for the tip.

        Raises:
            PoseError: the tubes cannot stand so, or `contact` lies beyond them.
            NotFinite: the wrench is not finite.
            NoSolution: no solution was reached.

        """
        place = math.inf if contact is None else contact
        if near is not None and joints.shape == (len(self.robot.joints),) and wrench.shape == (6,):
            found = Solution(np.empty_like(near.numbers))
            if newton(*self._fixed, joints, wrench, near.numbers, place, 1, CLOSE, *self._widths, found.numbers):
                return found
        self._check(joints, wrench, contact)
        rest = at_rest(joints, place, len(self.robot.tubes))
        if near is None:
            solution = self._newton(joints, wrench, rest, place, careful=0)
            if solution is not None:
                return solution if solution.stability > 0.0 else self._stable(solution)
        for start in (near, rest):
            solution = self._walk(start, joints, wrench, place) if start is not None else None
            if solution is not None:
                return solution
        solution = self._turn(joints, wrench, place)
        if solution is not None:
            return solution
        raise NoSolution(
            f"no shape found for {dict(zip(self.robot.joint_names, joints.tolist(), strict=True))}"
            f" under {wrench[:3].tolist()} N, {wrench[3:].tolist()} N m; is the load within reach of the tubes?"
        )

    def shape(self, solution: Solution) -> Array:
        """Cross-sections from the plate to the tip (m, 16 + 2q).

        A row holds arc length [m], the frame by rows (9), position (3) [m], theta_i [rad], u_iz [1/m]
        and the moment M (3) [N m], vectors in the world frame.
        """
        path, _ = self._pass(solution)
        path[:, 10:13] += self.robot.base.position
        return path

    def residual(self, solution: Solution) -> float:
        """Largest violation of an end condition [1/m or N m], evaluated anew."""
        _, state = self._pass(solution)
        q = len(self.robot.tubes)
        twist = self.robot.layout.stiffness[0, 1] / self.robot.layout.stiffness[0, 0]
        torsion = state[12 + q : 12 + 2 * q].copy()
        torsion[0] -= twist * (state[2:9:3] @ solution.wrench[3:])
        return float(max(np.abs(torsion).max(), np.abs(state[15 + 2 * q :] - solution.wrench[3:]).max()))

    def repeat_pass(self, solution: Solution, times: int, with_derivatives: bool) -> None:
        """Pass along the tubes `times` times: what the arithmetic alone costs."""
        alpha, beta = self.robot.tube_poses(solution.joints)
        tubes, columns = self._widths
        repeat(
            self.robot.layout, self._scheme, alpha, beta, solution.wrench[:3].copy(), solution.contact,
            solution.unknowns, tubes, columns if with_derivatives else (), times,
        )  # fmt: skip

    def _pass(self, solution: Solution) -> tuple[Array, Array]:
        """Sections (m, 16 + 2q), from the plate, and the state at the tip."""
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

    def _stable(self, balanced: Solution) -> Solution:
        """A stable shape at the same pose and load, found by twisting the tubes; the given one if there is none.

        A cold start on tubes that snap finds the shape between two stable ones, where no robot stays.
        """
        q = len(self.robot.tubes)
        for size in (2.0, 5.0, 10.0, 20.0):
            for signs in itertools.product((1.0, -1.0), repeat=q - 1):
                pushed = at_rest(balanced.joints, balanced.contact, q)
                pushed.numbers[:] = balanced.numbers
                pushed.sensitivity[:] = 0.0
                pushed.unknowns[:q] += size * np.array((-1.0, *signs))
                found = self._newton(balanced.joints, balanced.wrench, pushed, balanced.contact, careful=0)
                if found is not None and found.stability > 0.0:
                    return found
        return balanced

    def _walk(self, start: Solution, joints: Array, wrench: Array, contact: float) -> Solution | None:
        """From `start` on a straight line to the pose and the load, in more and more steps."""
        moved, loaded = joints - start.joints, wrench - start.wrench
        for increments in INCREMENTS:
            at: Solution | None = start
            for number in range(increments - 1, -1, -1):
                left = number / increments
                at = self._newton(joints - left * moved, wrench - left * loaded, at, contact, careful=0)
                if at is None:
                    break
            if at is not None:
                return at
        return None

    def _turn(self, joints: Array, wrench: Array, contact: float) -> Solution | None:
        """From tubes that are aligned, turned the short way round: what snaps is reached on a stable branch."""
        aligned, short = joints.copy(), joints.copy()
        outermost = float(self.robot.tube_poses(joints)[0][-1])
        for j, joint in enumerate(self.robot.joints):
            if joint.motion == "rotation":
                aligned[j] = outermost
                short[j] = outermost + math.remainder(joints[j] - outermost, math.tau)
        q = len(self.robot.tubes)
        at = self._newton(aligned, np.zeros(6), at_rest(aligned, contact, q), contact, careful=0)
        for goal in (np.zeros(6), wrench):
            at = self._walk(at, short, goal, contact) if at is not None else None
        if at is None:
            return None
        at.joints[:] = joints  # whole turns change nothing
        return at

    def _newton(self, joints: Array, wrench: Array, near: Solution, contact: float, careful: int) -> Solution | None:
        close = CLOSE if careful else CLOSEST
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
        """What `core.model.newton` is told in every solve: robot, order, sub-link, and its two widths."""
        return (*self._fixed, *self._widths)

    @cached_property
    def _scheme(self) -> Scheme:
        return Scheme(INTEGRATORS[self.integrator], self.sublink or SUBLINKS[self.integrator])

    @cached_property
    def _fixed(self) -> tuple[Array, int, float]:
        """What every solve is told."""
        return self.robot.packed, self._scheme.order, self._scheme.sublink

    @cached_property
    def _widths(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Numbers of tubes and of derivative columns (in whole vector registers), for the compiler."""
        q, n = len(self.robot.tubes), len(self.robot.joints)
        return (0.0,) * q, (0.0,) * (-(-(q + 3 + n + 3) // 4) * 4)
