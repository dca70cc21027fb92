"""The loaded model solved: base unknowns by Newton, then J and C of the solved problem, eq. (20).

Unknown at the plate are u_iz of every tube and M(0). Known at the far end: u_iz = 0 at each
tube's own end (the innermost carries the axial part of a tip moment) and M = the tip moment.
The derivative columns of the pass give the Newton step, and by the implicit function theorem the
way the unknowns themselves move with joints and load; J and C contain both parts, so that they
are the derivatives of the *solved* tip. The determinant of the same matrix is the margin of
elastic stability, see `stability`.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from core.errors import DescriptionError, NoSolution, NotFinite
from core.model.newton import CLOSE, CLOSEST, TOLERANCE, newton
from core.model.propagation import FIXED_ROWS, FRAME_ROWS, INTEGRATORS, Scheme, propagate, repeat
from core.model.relaxation import base_unknowns, cut, relax
from core.model.second_variation import negative_directions
from core.model.solution import Solution, at_rest
from core.robot.robot import Array, Robot, positive

__all__ = ["PAPER_SUBLINK", "SUBLINKS", "TOLERANCE", "Solution", "Statics"]

#: The paper's sub-link [m].
PAPER_SUBLINK = 0.010
#: Length of a sub-link unless another is asked for, by integrator [m].
SUBLINKS = {"paper": PAPER_SUBLINK, "fourth_order": 0.030}
#: Along a branch a step turns no tube by more [rad], and takes no more than this part of a load.
TURN, LOAD = 0.5, 0.25
#: Nor may its two ends disagree by more about where the other one is [rad over the whole length].
BESIDE = 0.25
#: A step that has become shorter than this part of the way has met the end of its branch.
SHORTEST = 1e-3
#: Steps of one way before it is given up: a load that is out of all reach.
MOST_STEPS = 200
#: Then the tubes are let go so far beyond it, in parts of the way.
BEYOND = (1e-3, 2e-2, 0.2)
#: So often at most on one way.
SNAPS = 4
#: Elements that tubes are cut into when they are let go, until Newton goes on from what comes out [m].
ELEMENTS = (0.02, 0.005)
#: Between two cross-sections when directions are counted [m].
SECTION = 0.005
#: Two ways to a shape have come to the same one when their tips are this close [m].
SAME = 1e-6


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
            near: a solution nearby, whose branch is followed; without it the robot is followed
                from rest, and the shape that it comes to is stable.
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
        solution = self._follow(near, joints, wrench, place) if near is not None else None
        if solution is None:
            solution = self._cold(joints, wrench, place)
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

    def negative_directions(self, solution: Solution) -> int:
        """In how many independent directions the elastic energy falls: 0 when the shape is stable.

        A cold solve has looked; a warm one follows its branch by the margin's sign. Under a moment at the tip, which
        has no energy, 0 is stable and more need not be unstable.
        """
        return negative_directions(
            self.robot, solution.joints, solution.wrench, solution.contact, self._sections(solution)
        )

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

    def _sections(self, solution: Solution) -> Array:
        """Sections (m, 16 + 2q), from the plate, in short steps; in the world's axes."""
        alpha, beta = self.robot.tube_poses(solution.joints)
        tubes, columns = self._widths
        q, length = len(tubes), float(beta[0]) + self.robot.tubes[0].length
        scheme = Scheme(self._scheme.order, min(self._scheme.sublink, SECTION))
        path = np.empty((int(length / scheme.sublink) + 4 + int(self.robot.layout.counts.sum()), 16 + 2 * q))
        # With columns, although nothing is differentiated: another width would have to be compiled for this alone.
        state, rates = np.empty(18 + 2 * q), np.empty((FRAME_ROWS + 2 * q + FIXED_ROWS) * len(columns))
        passed = propagate(
            self.robot.layout, scheme, alpha, beta, solution.wrench, solution.contact, solution.unknowns,
            tubes, columns, state, rates, path,
        )  # fmt: skip
        return path[:passed]

    def _cold(self, joints: Array, wrench: Array, contact: float) -> Solution | None:
        """The stable shape that the robot comes to from rest; None when none was reached.

        Mostly Newton finds the same one at once, and then J and C are those of its own last pass.
        """
        found = self._from_rest(joints, wrench, contact)
        if found is None:
            return None
        rest = at_rest(joints, contact, len(self.robot.tubes))
        direct = self._newton(joints, wrench, rest, contact, careful=0)
        if direct is not None and np.linalg.norm(direct.tip - found.tip) < SAME:
            found = direct
        if self.negative_directions(found) == 0:
            return found
        # Both ways may keep to a shape that is balanced and nothing more, such as a straight tube under pressure.
        fallen = self._let_go(found, joints, wrench, contact)
        # What a moment at the tip does is no energy's: then a shape may stay although its energy could fall.
        return found if fallen is None and wrench[3:].any() and found.stability > 0.0 else fallen

    def _from_rest(self, joints: Array, wrench: Array, contact: float) -> Solution | None:
        """Tubes aligned with the outermost and no load; then turned, each the shorter way round; then loaded."""
        aligned, short, nothing = joints.copy(), joints.copy(), np.zeros(6)
        outermost = float(self.robot.tube_poses(joints)[0][-1])
        for j, joint in enumerate(self.robot.joints):
            if joint.motion == "rotation":
                aligned[j] = outermost
                short[j] = outermost + math.remainder(joints[j] - outermost, math.tau)
        rest = at_rest(aligned, contact, len(self.robot.tubes))
        at = self._newton(aligned, nothing, rest, contact, careful=0)
        if at is None or self.negative_directions(at) > 0:
            at = self._let_go(None, aligned, nothing, contact)
        for load in (nothing, wrench):
            at = self._follow(at, short, load, contact) if at is not None else None
        if at is not None:
            at.joints[:] = joints  # whole turns change nothing
        return at

    def _follow(
        self, start: Solution, joints: Array, wrench: Array, contact: float, snaps: int = SNAPS
    ) -> Solution | None:
        """From `start` on a straight line to the pose and the load, in steps short enough to stay on the branch.

        Where the branch ends the tubes snap, `snaps` times at most, and it goes on from where they have come to rest.
        """
        moved, loaded = joints - start.joints, wrench - start.wrench
        longest = 1.0 / max(1.0, np.abs(moved).max(initial=0.0) / TURN, float(loaded.any()) / LOAD)
        at, done, step = start, 0.0, longest
        for _ in range(MOST_STEPS):
            if done == 1.0:
                return at
            to = min(1.0, done + step)
            pose, load = joints - (1.0 - to) * moved, wrench - (1.0 - to) * loaded
            found = self._newton(pose, load, at, contact, careful=1)
            if found is not None and self._beside(at, found) < BESIDE:
                at, done, step = found, to, min(2.0 * step, longest)
            elif step > SHORTEST:
                step *= 0.25
            else:
                break
        if snaps == 0:
            return None
        # Elements fold a little sooner or later than sub-links do: a snap shows a little beyond the end of the branch.
        for beyond in BEYOND:
            to = done + beyond
            pose, load = joints - (1.0 - to) * moved, wrench - (1.0 - to) * loaded
            if to <= 1.0 or self.robot.stands(pose):
                found = self._let_go(at, pose, load, contact)
                if found is not None:
                    return self._follow(found, joints, wrench, contact, snaps - 1)
        return None

    def _beside(self, here: Solution, there: Solution) -> float:
        """How far the slopes of two solutions miss the other one [rad over the whole length]: far on two branches."""
        move = np.concatenate((there.joints - here.joints, there.wrench - here.wrench))
        change = there.unknowns - here.unknowns
        q = len(self.robot.tubes)
        length = float(self.robot.tube_poses(there.joints)[1][0]) + self.robot.tubes[0].length
        misses = np.abs([change - here.sensitivity @ move, change - there.sensitivity @ move]).max(axis=0)
        misses[q:] /= self.robot.layout.stiffness[0, 0]
        return length * float(misses.max())

    def _let_go(self, near: Solution | None, joints: Array, wrench: Array, contact: float) -> Solution | None:
        """The stable shape that the energy falls to from `near`, or from untwisted tubes; None if it was not found."""
        force = np.append(wrench[:3], np.zeros(3))
        if np.linalg.norm(force) * ELEMENTS[-1] ** 2 > self.robot.layout.stiffness[0, 0]:
            return None  # it bends the innermost tube within an element, and a sub-link
        for longest in ELEMENTS:
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


def _at(path: Array, values: Array, places: Array) -> Array:
    """Columns of `values`, known at the arc lengths of a path, at other ones."""
    columns: list[Array] = [np.interp(places, path[:, 0], column) for column in values.T]
    return np.column_stack(columns)
