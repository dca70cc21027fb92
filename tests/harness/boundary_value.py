"""Independent solution of the tubes' boundary-value problem, the judge of the model's tip, J and C.

The equations of Rucker, Jones and Webster (2010) in world axes: each tube i turns by theta_i about the tangent t of one
frame R, and internal force n and moment m are those of all tubes together,

    r' = t,  R' = R [k x],  theta_i' = u_i,  m' = -t x n,  n' = -(weight of the tubes at this cross-section),
    sum EI_i k = sum EI_i w_i + (R^T m)_xy,  GJ_i u_i' = EI_i (k x w_i)_z,  w_i: precurvature turned by theta_i.

`scipy` integrates them with error control (DOP853); a shooting method satisfies the end conditions u_i = 0 at each
tube's own end and m = 0 at the last one. Every point load, also that of the tip, makes n and m jump at its place.
Nothing is shared with `core.model` but the robot's description.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from core.robot.robot import Array, Robot

#: Relative and absolute tolerance of the integration.
TOLERANCE = 1e-9
#: Step of the central differences by unknowns, joints and load [1/m, N m, rad, m, N].
STEP = 1e-5


class Point(NamedTuple):
    """A force on the tubes at one arc length."""

    arc: float  #: arc length from the plate [m]
    force: Array  #: (3,) world frame [N]


class BoundarySolution(NamedTuple):
    """A solved shape; world frame."""

    tip: Array  #: (3,) position of the innermost tube's end [m]
    rotation: Array  #: (3, 3) frame of the innermost tube there
    jacobian: Array  #: (6, n) derivative by the joints
    compliance: Array  #: (6, 6) derivative by force and moment at the tip
    unknowns: Array  #: (q + 3,) torsion of each tube [1/m] and moment (3) at the plate [N m]
    margin: float  #: determinant of the end conditions by the unknowns


def boundary_value(
    robot: Robot, joints: Array, wrench: Array, guess: Array | None = None, points: Sequence[Point] = (),
    weights: Array | None = None,
) -> BoundarySolution:  # fmt: skip
    """Solve for joints (n,) under a wrench at the tip (6,), point forces, and weights of the tubes (q, 3) [N/m]."""
    q, n = len(robot.tubes), joints.size
    at = np.concatenate((np.zeros(q + 3) if guess is None else guess, joints, wrench))
    steps = np.vstack((np.zeros(at.size), STEP * np.eye(at.size), -STEP * np.eye(at.size)))
    change = np.full(q + 3, np.inf)
    for _ in range(20):
        ends, tips, frames = _integrated(robot, at + steps, points, np.zeros((q, 3)) if weights is None else weights)
        slopes = (ends[1 : at.size + 1] - ends[at.size + 1 :]).T / (2.0 * STEP)
        change = np.linalg.solve(slopes[:, : q + 3], ends[0])
        at[: q + 3] -= change
        if np.abs(change).max() < 1e-7:
            break
    else:
        raise AssertionError(f"no solution at {joints}: last change {np.abs(change).max():.2g}")
    move = (tips[1 : at.size + 1] - tips[at.size + 1 :]).T
    turn = Rotation.from_matrix(frames[1 : at.size + 1] @ frames[at.size + 1 :].transpose(0, 2, 1)).as_rotvec().T
    tip_slopes = np.vstack((move, turn)) / (2.0 * STEP)
    total = tip_slopes[:, q + 3 :] - tip_slopes[:, : q + 3] @ np.linalg.solve(slopes[:, : q + 3], slopes[:, q + 3 :])
    margin = float(np.linalg.det(slopes[:, : q + 3]))
    return BoundarySolution(tips[0], frames[0], total[:, :n], total[:, n:], at[: q + 3].copy(), margin)


@dataclass(frozen=True)
class _Link:
    """A piece of the tubes on which none begins or ends, for b rows of variables at a time."""

    rows: int
    own: Array  #: (q, 2) precurvature [1/m]
    bend: Array  #: (q,) EI, 0 for an absent tube [N m^2]
    torsional: Array  #: (q,) GJ [N m^2]
    pull: Array  #: (3,) weight per length [N/m]
    length: Array  #: (b,) [m]

    def slope(self, _: float, flat: Array) -> Array:
        """Return the derivative of all rows by the share of the length."""
        y, q, b = flat.reshape(self.rows, -1), len(self.bend), self.rows
        axes, theta, u = y[:, 3:12].reshape(b, 3, 3), y[:, 12 : 12 + q], y[:, 12 + q : 12 + 2 * q]
        m, internal = y[:, 12 + 2 * q : 15 + 2 * q], y[:, 15 + 2 * q :]
        wx = np.cos(theta) * self.own[:, 0] - np.sin(theta) * self.own[:, 1]
        wy = np.sin(theta) * self.own[:, 0] + np.cos(theta) * self.own[:, 1]
        local = np.einsum("bji,bj->bi", axes, m)
        kx, ky = ((self.bend * w).sum(axis=1) + local[:, i] for i, w in enumerate((wx, wy)))
        k = np.column_stack((kx, ky, 0.0 * kx)) / self.bend.sum()
        t = axes[:, :, 2]
        change = np.hstack((
            t, np.cross(axes, k[:, None]).reshape(b, 9), u * (self.bend > 0.0),
            self.bend / self.torsional * (k[:, :1] * wy - k[:, 1:2] * wx), -np.cross(t, internal),
            np.tile(-self.pull, (b, 1)),
        ))  # fmt: skip
        return np.asarray(self.length[:, None] * change, np.float64).ravel()


def _integrated(robot: Robot, rows: Array, points: Sequence[Point], weights: Array) -> tuple[Array, Array, Array]:
    """Return end conditions (b, q + 3), tips (b, 3) and frames (b, 3, 3) for rows of unknowns, joints and wrench."""
    q, n, b = len(robot.tubes), len(robot.joints), len(rows)
    poses = [robot.tube_poses(row) for row in rows[:, q + 3 : q + 3 + n]]
    alpha, beta = (np.array(part) for part in zip(*poses, strict=True))
    force, moment = rows[:, -6:-3].copy(), rows[:, -3:]
    stiffness, torsional = robot.layout.stiffness[:, 0], robot.layout.stiffness[:, 0] / robot.layout.stiffness[:, 1]
    reach = beta + [tube.length for tube in robot.tubes]
    marks = [
        (i, s, beta[:, i] + end)
        for i in range(q)
        for s, end in enumerate(robot.layout.ends[i, : robot.layout.counts[i]])
    ]
    marks += [(-1, k, np.full(b, point.arc)) for k, point in enumerate(points)]
    section = np.array([sum(i == j and arc[0] <= 0.0 for j, _, arc in marks) for i in range(q)])
    n_force = force + sum((point.force for point in points), np.zeros(3)) + np.maximum(reach, 0.0) @ weights
    r, frame = np.zeros((b, 3)), np.tile(robot.base.rotation, (b, 1, 1))
    torsion = rows[:, :q].copy()
    state = np.hstack((r, frame.reshape(b, 9), alpha - beta * torsion, torsion, rows[:, q : q + 3], n_force))
    tip, tip_frame, twisting, here = r, frame, np.zeros(b), np.zeros(b)
    for tube, number, arc in sorted(
        (mark for mark in marks if mark[2][0] > 0.0), key=lambda mark: (mark[2][0], -mark[0])
    ):
        present = section < robot.layout.counts
        bend = np.where(present, stiffness, 0.0)
        own = np.array([robot.layout.curvatures[i, min(section[i], robot.layout.counts[i] - 1)] for i in range(q)])
        link = _Link(b, own, bend, torsional, weights[present].sum(axis=0), arc - here)
        done = solve_ivp(link.slope, (0.0, 1.0), state.ravel(), "DOP853", rtol=TOLERANCE, atol=TOLERANCE)
        state, here = np.asarray(done.y[:, -1], np.float64).reshape(b, -1), arc
        if tube < 0:
            state[:, 15 + 2 * q :] -= points[number].force
            continue
        section[tube] += 1
        if tube == 0 and section[0] == robot.layout.counts[0]:
            tip, tip_frame = state[:, :3].copy(), state[:, 3:12].reshape(b, 3, 3).copy()
            state[:, 12 + 2 * q : 15 + 2 * q] -= moment
            state[:, 15 + 2 * q :] -= force
            twisting = np.einsum("bi,bi->b", tip_frame[:, :, 2], moment) / torsional[0]
    ends = np.hstack((state[:, 12 + q : 12 + 2 * q], state[:, 12 + 2 * q : 15 + 2 * q]))
    ends[:, 0] -= twisting
    spin = Rotation.from_rotvec(np.outer(state[:, 12], [0.0, 0.0, 1.0])).as_matrix()
    return ends, tip + np.array(robot.base.position), tip_frame @ spin
