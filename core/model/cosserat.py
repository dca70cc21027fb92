"""The exact rod model, the reference for the fast model.

The exact rod is a geometrically exact Cosserat rod model (Rucker, Jones, Webster 2010) in the frame of the innermost
tube. A quaternion is the orientation; moment and force are in the moving frame:

    m' = -u x m - e_z x n,   n = R^T F,   m_z = sum_i GJ_i u_iz,   psi_i' = u_iz - u_1z,

Classical Runge-Kutta steps integrate these equations with negligible truncation error. A shooting method with Newton
steps satisfies the conditions at the tip. The exact rod shares only the description of the robot with `propagation`,
not its variables, frames, integrator or derivatives. The virtual lab also uses it to simulate the real robot.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.errors import NoSolution, NotFinite, PoseError
from core.model.uniqueness import is_unique
from core.robot.robot import Array, Indices, Layout, Robot, farthest_end, positive

#: Path of equilibria: longest and shortest stride [rad], largest number of strides, and smallest cosine between the
#: directions of two strides.
LONGEST_STRIDE_RAD, SHORTEST_STRIDE_RAD, MAX_STRIDES, MIN_COSINE = 0.5, 1e-4, 2000, 0.9
#: Half step of the central differences by unit of the varied quantity.
HALF_STEPS = {"rad": 1e-5, "m": 1e-5, "N": 3e-5, "N m": 3e-6}
#: Length that scales the unknowns of tubes that are flush with the plate [m].
MIN_LENGTH_M = 1e-3


class Rod(NamedTuple):
    """An exactly solved robot; world frame."""

    tip: Array  #: (3,) position of the tip [m]
    rotation: Array  #: (3, 3) frame of the innermost tube at the tip
    torsion: Array  #: (q,) torsion u_iz of each tube at the plate [1/m]
    unknowns: Array  #: (q + 2,) m_x, m_y [N m] and u_iz [1/m] at the plate, the start values of a warm start
    chord: Array  #: (q + 2, q + 2) inverse of the end conditions' derivative, for the next Newton solve
    iterations: int


class Loads(NamedTuple):
    """Loads in addition to the wrench at the tip; world frame."""

    points: Sequence[tuple[float, Array]] = ()  #: arc length from the plate [m] and force (3,) [N] of each point load
    weights: Array | None = None  #: (q, 3) force per length of each tube, along its free part [N/m]; None: no weight
    distributed: Array | None = None  #: (3,) force per length from the plate to the last tube end [N/m]; None: none

    def rows(self, tubes: int) -> Array:
        """Return rows (k, 4): sorted points (arc length, force), one of the distributed load, and one for each tube."""
        found = np.zeros((len(self.points) + 1 + tubes, 4))
        for row, (arc, force) in zip(found, sorted(self.points, key=lambda point: point[0]), strict=False):
            row[0], row[1:] = arc, force
        found[len(self.points), 1:] = 0.0 if self.distributed is None else self.distributed
        found[len(self.points) + 1 :, 1:] = 0.0 if self.weights is None else self.weights
        return found


#: Rows of `Loads` for the wrench at the tip alone.
NO_LOADS = np.empty((0, 4))


class _Load(NamedTuple):
    """All loads on the tubes."""

    wrench: Array  #: (6,) world frame [N, N m]
    contact: float  #: arc length from the plate at which the force of the wrench acts [m]; inf for the tip
    more: Array = NO_LOADS  #: rows of `Loads`

    def times(self, share: float) -> "_Load":
        """Return all loads times `share`."""
        return _Load(share * self.wrench, self.contact, self.more * [1.0, share, share, share])


@dataclass(frozen=True)
class ExactRod:
    """Solver of the exact rod for one robot."""

    robot: Robot
    step: float = 0.002  #: longest Runge-Kutta step [m]; the error at 2 mm is below 1e-9 m
    tolerance: float = 1e-9  #: largest violation of the end conditions [1/m and N m]

    def __post_init__(self) -> None:
        positive("step", self.step, "m")

    def solve(
        self, joints: Array, wrench: Array, near: Rod | None = None, contact: float | None = None,
        loads: Loads | None = None,
    ) -> Rod:  # fmt: skip
        """Solve for joints (n,) [rad or m] under a force and a tip moment (6,), world frame [N, N m].

        Without `near` the result is the stable shape that the robot reaches from rest (aligned, unloaded tubes).

        The force acts at arc length `contact` from the plate [m]; None is the tip. `loads` are further loads.

        Raises:
            PoseError: the pose is invalid, or a load is beyond the tubes.
            NotFinite: a load is not finite.
            NoSolution: no solution was reached.

        """
        self.robot.check_pose(joints)
        alpha, beta = self.robot.tube_poses(joints)
        contact = self.robot.check_contact(joints, contact)
        return self.solve_tubes(alpha, beta, wrench, near, contact, self._rows(joints, loads))

    def near(self, rod: Rod, alpha: Array, beta: Array, wrench: Array, contact: float) -> Rod | None:
        """Return the shape of the tubes that Newton's method finds from the shape `rod`; None if it finds none."""
        return self._shoot(alpha, beta, _Load(wrench, contact), rod.unknowns, rod.chord)

    def _rows(self, joints: Array, loads: Loads | None) -> Array:
        if loads is None:
            return NO_LOADS
        rows, end = loads.rows(len(self.robot.tubes)), float(self.robot.tube_ends(joints).max())
        if not np.isfinite(rows).all():
            raise NotFinite("every arc length and force of the further loads must be a finite number")
        if outside := [arc for arc, _ in loads.points if not 0.0 <= arc <= end]:
            raise PoseError(f"a load at {1e3 * outside[0]:g} mm is outside 0 ... {1e3 * end:g} mm (the last tube end)")
        return rows

    def solve_tubes(
        self, alpha: Array, beta: Array, wrench: Array, near: Rod | None = None, contact: float = math.inf,
        loads: Array = NO_LOADS,
    ) -> Rod:  # fmt: skip
        """Solve for the tubes' rotations (q,) [rad] and proximal ends (q,) [m], with further loads as `Loads.rows`."""
        if wrench.shape != (6,) or not np.isfinite(wrench).all():
            raise NotFinite(f"tip wrench {wrench.tolist()} [N, N m] must be six finite numbers")
        load = _Load(wrench, contact, loads)
        if near is not None:
            rod = self._shoot(alpha, beta, load, near.unknowns, near.chord)
            if rod is not None:
                return rod
        rod = self._direct(alpha, beta, load) or self._from_rest(alpha, beta, load)
        if rod is None:
            raise NoSolution(
                f"the exact rod found no shape at rotations {alpha.tolist()} rad, proximal ends {beta.tolist()} m under"
                f" {wrench[:3].tolist()} N, {wrench[3:].tolist()} N m: reduce the load, or check the tubes"
            )
        return rod

    def _direct(self, alpha: Array, beta: Array, load: _Load) -> Rod | None:
        """Return the shape if a proof exists that it is the only one, else None; the load is applied in steps."""
        force, q = math.hypot(*load.wrench[:3]), len(self.robot.tubes)
        if load.wrench[3:].any() or load.more.size:
            return None
        if not is_unique(self.robot.layout, beta, force, load.contact, (0.0,) * q):
            return None
        nothing = np.zeros((q + 2, q + 2))
        for increments in (1, 4, 16, 64):
            unknowns, rod = np.zeros(q + 2), None
            for number in range(1, increments + 1):
                rod = self._shoot(alpha, beta, load.times(number / increments), unknowns, nothing)
                if rod is None:
                    break
                unknowns = rod.unknowns
            if rod is not None:
                return rod
        return None

    def _from_rest(self, alpha: Array, beta: Array, load: _Load) -> Rod | None:
        """Return the stable shape that the robot reaches from rest; None if there is none.

        The tubes are aligned and without load at rest. Each turns by at most half a turn, then the load is applied.
        """
        turns = np.array([math.remainder(angle - alpha[-1], math.tau) for angle in alpha])
        rest, nothing = np.full(len(turns), alpha[-1]), _Load(np.zeros(6), load.contact)
        start = self._at_rest(rest, beta, nothing)
        if start is None:
            return None
        pushed = (rest + turns, 0.0 * turns, load)
        # Where the branch of the first path ends without a stable shape, the tubes turn while the load grows.
        for path in (((rest, turns, nothing), pushed), ((rest, turns, load),)):
            unknowns: Array | None = start
            for at, turn, push in path:
                if unknowns is not None and (turn.any() or push.wrench.any() or push.more.any()):
                    unknowns = self._follow(at, turn, beta, push, unknowns)
            if unknowns is not None:
                return self._shoot(alpha, beta, load, unknowns, np.zeros((len(start), len(start))))
        return None

    def _at_rest(self, alpha: Array, beta: Array, nothing: _Load) -> Array | None:
        """Return the unknowns of a stable shape of aligned tubes, whose curves may oppose each other."""
        size = alpha.size + 2
        guesses = [np.zeros(size), *(sign * row for row in 10.0 * np.eye(size)[2:] for sign in (1.0, -1.0))]
        for guess in guesses:
            rod = self._shoot(alpha, beta, nothing, guess, np.zeros((size, size)))
            if rod is not None and self._margin(alpha, beta, nothing, rod.unknowns) > 0.0:
                return rod.unknowns
        return None

    def _follow(self, start: Array, turn: Array, beta: Array, load: _Load, unknowns: Array) -> Array | None:
        """Follow the equilibria while the tubes turn from `start` by `turn` (q,) [rad] and the load grows to `load`.

        The path's arc length in the space of unknowns and share of the change is the parameter. The path continues
        where the tubes snap: there the share falls along the unstable branch until the next stable branch starts.

        Returns:
            Unknowns of the first stable shape at the end of the change; None if there is none.
        """
        size = unknowns.size
        scale = np.full(size + 1, max(farthest_end(self.robot.layout, beta), MIN_LENGTH_M))
        scale[:2] /= self.robot.layout.stiffness[0, 0]
        scale[-1] = max(1.0, float(np.abs(turn).max()))

        def ends(point: Array) -> Array:
            values = point / scale
            return self._end_conditions(start + values[-1] * turn, beta, load.times(float(values[-1])), values[:-1])

        at = np.append(unknowns, 0.0) * scale
        first = _corrected(ends, at, np.append(np.zeros(size), 1.0), self.tolerance)
        if first is None:
            return None
        (at, direction), stride = first, LONGEST_STRIDE_RAD
        for _ in range(MAX_STRIDES):
            if stride < SHORTEST_STRIDE_RAD:
                return None
            found = _corrected(ends, at + stride * direction, direction, self.tolerance)
            if found is None or (found[1] @ direction) < MIN_COSINE:
                stride *= 0.5
                continue
            point, tangent = found
            if min(at[-1], point[-1]) < scale[-1] <= max(at[-1], point[-1]):
                share = (scale[-1] - at[-1]) / (point[-1] - at[-1])
                guess = (at + share * (point - at)) / scale
                rod = self._shoot(start + turn, beta, load, guess[:-1], np.zeros((size, size)))
                if rod is None or np.abs((rod.unknowns - guess[:-1]) * scale[:-1]).max() > stride:
                    stride *= 0.5
                    continue
                if self._margin(start + turn, beta, load, rod.unknowns) > 0.0:
                    return rod.unknowns
            at, direction, stride = point, tangent, min(1.5 * stride, LONGEST_STRIDE_RAD)
        return None

    def _end_conditions(self, alpha: Array, beta: Array, load: _Load, unknowns: Array) -> Array:
        """Return the violation of the end conditions (q + 2,) [N m and 1/m]."""
        layout, q = self.robot.layout, len(self.robot.tubes)
        ends = np.empty(q + 2)
        plate = to_plate(layout, load.wrench)
        _integrate(
            layout, alpha, beta, plate, load.contact, load.more, unknowns, self.step, np.empty(9 + 2 * q), ends,
            np.empty((0, 7)),
        )  # fmt: skip
        return ends

    def derivatives(
        self, joints: Array, wrench: Array, rod: Rod, contact: float | None = None, loads: Loads | None = None
    ) -> Array:
        """Return derivatives (6, n + 6) of the tip's position and rotation by joints, force and moment at a solution.

        They are central differences, or one-sided ones where a step is impossible, for example behind the plate.
        """
        halves = (
            [HALF_STEPS[joint.unit] for joint in self.robot.joints] + 3 * [HALF_STEPS["N"]] + 3 * [HALF_STEPS["N m"]]
        )
        columns, n = np.empty((6, len(halves))), joints.size
        for k, half in enumerate(halves):
            move, sides = half * np.eye(len(halves))[k], list[tuple[float, Rod]]()
            for sign in (1.0, -1.0):
                try:
                    to = self.solve(joints + sign * move[:n], wrench + sign * move[n:], rod, contact, loads)
                    sides.append((sign, to))
                except (PoseError, NoSolution):
                    sides.append((0.0, rod))
            (up, above), (down, below) = sides
            turn = above.rotation @ below.rotation.T
            columns[:3, k] = above.tip - below.tip
            columns[3:, k] = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            columns[:, k] /= (up - down) * half if up > down else np.nan
        return columns

    def stability(
        self, joints: Array, wrench: Array, rod: Rod, contact: float | None = None, loads: Loads | None = None
    ) -> float:
        """Return the determinant of the derivative of the end conditions by the unknowns, by central differences.

        This number corresponds to `Solution.stability`: 1 for straight tubes without load, 0 where the tubes snap.
        """
        alpha, beta = self.robot.tube_poses(joints)
        load = _Load(wrench, self.robot.check_contact(joints, contact), self._rows(joints, loads))
        return self._margin(alpha, beta, load, rod.unknowns)

    def _margin(self, alpha: Array, beta: Array, load: _Load, unknowns: Array) -> float:
        columns: list[Array] = []
        for k in range(unknowns.size):
            half = 1e-4 * np.eye(unknowns.size)[k] * (self.robot.layout.stiffness[0, 0] if k < 2 else 1.0)
            up, down = (self._end_conditions(alpha, beta, load, unknowns + h) for h in (half, -half))
            columns.append((up - down) / (2.0 * half[k]))
        return float(np.linalg.det(np.column_stack(columns)))

    def _shoot(self, alpha: Array, beta: Array, load: _Load, guess: Array, chord: Array) -> Rod | None:
        unknowns, inverse, tip, rotation, iterations, residual = shoot(
            self.robot.layout, alpha, beta, *load, guess, chord, self.step, self.tolerance
        )
        if not residual <= self.tolerance:
            return None
        return Rod(tip, rotation, unknowns[2:], unknowns, inverse, iterations)


def _corrected(
    ends: Callable[[Array], Array], guess: Array, direction: Array, tolerance: float
) -> tuple[Array, Array] | None:
    """Return the equilibrium in the plane through `guess` across `direction`, and the path's tangent there; or None."""
    point, plane = guess.copy(), float(guess @ direction)
    for _ in range(8):
        here = ends(point)
        slopes = np.column_stack([(ends(point + h) - here) / 1e-6 for h in 1e-6 * np.eye(point.size)])
        matrix = np.vstack((slopes, direction))
        if not np.isfinite(matrix).all():
            return None
        try:
            both = np.linalg.solve(
                matrix, np.column_stack((np.append(here, point @ direction - plane), np.eye(point.size)[-1]))
            )
        except np.linalg.LinAlgError:
            return None
        if np.abs(here).max() < 10.0 * tolerance:
            return point, both[:, 1] / np.linalg.norm(both[:, 1])
        point = point - both[:, 0]
    return None


@compiled
def to_plate(layout: Layout, wrench: Array) -> Array:
    """Return force and moment (6,) of a world-frame wrench in the plate's axes, the axes of the rod equations."""
    result = np.zeros(6)
    for i in range(3):
        for k in range(3):
            result[i] += layout.base[3 * k + i] * wrench[k]
            result[3 + i] += layout.base[3 * k + i] * wrench[3 + k]
    return result


@compiled
def to_world(layout: Layout, y: Array) -> tuple[Array, Array]:
    """Return tip (3,) [m] and tip frame (3, 3) in world coordinates from the state `y` at the tip."""
    own, tip, rotation = np.empty((3, 3)), np.empty(3), np.zeros((3, 3))
    _rotation(y, own)
    for i in range(3):
        tip[i] = layout.base[9 + i]
        for k in range(3):
            tip[i] += layout.base[3 * i + k] * y[4 + k]
            for j in range(3):
                rotation[i, j] += layout.base[3 * i + k] * own[k, j]
    return tip, rotation


@compiled
def _rotation(y: Array, out: Array) -> None:
    """Write the rotation matrix of the quaternion y[:4] = (w, x, y, z), of any nonzero length, to `out`."""
    w, a, b, c = y[0], y[1], y[2], y[3]
    scale = 2.0 / (w * w + a * a + b * b + c * c)
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - scale * (b * b + c * c), scale * (a * b - w * c), scale * (a * c + w * b)
    out[1, 0], out[1, 1], out[1, 2] = scale * (a * b + w * c), 1.0 - scale * (a * a + c * c), scale * (b * c - w * a)
    out[2, 0], out[2, 1], out[2, 2] = scale * (a * c - w * b), scale * (b * c + w * a), 1.0 - scale * (a * a + b * b)


@compiled
def slope(
    y: Array, out: Array, turn: Array, bend: Array, twist: Array, ratio: Array, curvature: Array, softness: float,
    force: Array,
) -> None:  # fmt: skip
    """Write the derivative of y = quaternion (4), r (3), m_x, m_y, u_iz (q), psi_i (q) along the arc length.

    `bend` is EI and `twist` GJ of each tube (q,), 0 for a tube that is absent at this cross-section. `ratio` is EI /
    GJ, 0 for an absent tube. `softness` is 1 / sum EI. `force` is the force (3,) beyond the cross-section, plate's
    axes. `turn` (q, 2) is scratch memory for cosine and sine of psi_i; psi of the innermost tube is 0.
    """
    q = bend.shape[0]
    w, a, b, c = y[0], y[1], y[2], y[3]
    scale = 2.0 / (w * w + a * a + b * b + c * c)
    dx, dy, dz = scale * (a * c + w * b), scale * (b * c - w * a), 1.0 - scale * (a * a + b * b)
    fx, fy, fz = force[0], force[1], force[2]
    nx = fx + scale * (-fx * (b * b + c * c) + fy * (a * b + w * c) + fz * (a * c - w * b))
    ny = fy + scale * (fx * (a * b - w * c) - fy * (a * a + c * c) + fz * (b * c + w * a))
    uz = y[9]
    ux, uy, mz = y[7] + bend[0] * curvature[0, 0], y[8] + bend[0] * curvature[0, 1], twist[0] * uz
    for i in range(1, q):
        if ratio[i] > 0.0:
            cos, sin = np.cos(y[9 + q + i]), np.sin(y[9 + q + i])
            turn[i, 0], turn[i, 1] = cos, sin
            ux += bend[i] * (cos * curvature[i, 0] - sin * curvature[i, 1])
            uy += bend[i] * (sin * curvature[i, 0] + cos * curvature[i, 1])
            mz += twist[i] * y[9 + i]
    ux, uy = softness * ux, softness * uy
    out[0] = 0.5 * (-a * ux - b * uy - c * uz)
    out[1] = 0.5 * (w * ux + b * uz - c * uy)
    out[2] = 0.5 * (w * uy - a * uz + c * ux)
    out[3] = 0.5 * (w * uz + a * uy - b * ux)
    out[4], out[5], out[6] = dx, dy, dz
    out[7] = -(uy * mz - uz * y[8]) + ny
    out[8] = -(uz * y[7] - ux * mz) - nx
    out[9], out[9 + q] = ratio[0] * (ux * curvature[0, 1] - uy * curvature[0, 0]), 0.0
    for i in range(1, q):
        out[9 + i], out[9 + q + i] = 0.0, 0.0
        if ratio[i] > 0.0:
            cos, sin = turn[i, 0], turn[i, 1]
            uix, uiy = cos * ux + sin * uy, cos * uy - sin * ux
            out[9 + i] = ratio[i] * (uix * curvature[i, 1] - uiy * curvature[i, 0])
            out[9 + q + i] = y[9 + i] - uz


@compiled
def start_state(layout: Layout, alpha: Array, beta: Array, unknowns: Array, y: Array, section: Indices) -> float:
    """Set the state `y` and each tube's section index at the plate; return the innermost tube's angle there [rad]."""
    q = layout.counts.shape[0]
    theta = float(alpha[0] - beta[0] * unknowns[2])
    y[:] = 0.0
    y[0], y[3] = np.cos(0.5 * theta), np.sin(0.5 * theta)
    # The unknown moment is in the plate's axes, so a rotation of the innermost tube does not change it.
    y[7] = np.cos(theta) * unknowns[0] + np.sin(theta) * unknowns[1]
    y[8] = np.cos(theta) * unknowns[1] - np.sin(theta) * unknowns[0]
    section[:] = 0
    for i in range(q):
        y[9 + i] = unknowns[2 + i]
        y[9 + q + i] = alpha[i] - beta[i] * unknowns[2 + i] - theta
        while section[i] < layout.counts[i] and beta[i] + layout.ends[i, section[i]] <= 0.0:
            section[i] += 1
    return theta


@compiled
def present(layout: Layout, beta: Array, section: Indices, bend: Array, twist: Array, ratio: Array, curvature: Array,
    ) -> tuple[float, int, float]:  # fmt: skip
    """Set stiffness and curvature of the tubes present; return the next section end [m], its tube, and sum EI."""
    end, end_tube, total = np.inf, -1, 0.0
    for i in range(bend.shape[0]):
        bend[i] = twist[i] = ratio[i] = 0.0
        if section[i] < layout.counts[i]:
            section_end = beta[i] + layout.ends[i, section[i]]
            if section_end < end:
                end, end_tube = section_end, i
            bend[i], ratio[i] = layout.stiffness[i, 0], layout.stiffness[i, 1]
            twist[i] = bend[i] / ratio[i]
            curvature[i, 0] = layout.curvatures[i, section[i], 0]
            curvature[i, 1] = layout.curvatures[i, section[i], 1]
            total += bend[i]
    return end, end_tube, total


@compiled
def put_point(path: Array, at: int, arc: float, y: Array) -> int:
    """Write arc length, position and tangent of state `y` to row `at` of `path` (m, 7); return the next row.

    A path without a free row is left unchanged.
    """
    if at >= path.shape[0]:
        return at
    w, a, b, c = y[0], y[1], y[2], y[3]
    scale = 2.0 / (w * w + a * a + b * b + c * c)
    path[at, 0] = arc
    path[at, 1], path[at, 2], path[at, 3] = y[4], y[5], y[6]
    path[at, 4], path[at, 5] = scale * (a * c + w * b), scale * (b * c - w * a)
    path[at, 6] = 1.0 - scale * (a * a + b * b)
    return at + 1


def path_rows(robot: Robot, step: float) -> Array:
    """Return NaN rows (m, 7) that suffice for the centre line of a robot with integration steps of `step` [m]."""
    steps = sum(int(tube.length / step) + 1 for tube in robot.tubes)
    return np.full((steps + robot.layout.ends.size + 2, 7), np.nan)


def world_path(robot: Robot, path: Array) -> Array:
    """Return the rows of a centre line in the plate's axes that are not NaN, in the world frame (k, 7)."""
    rows = path[np.isfinite(path[:, 0])].copy()
    base, rotation = np.array(robot.base.position), robot.base.rotation
    rows[:, 1:4] = rows[:, 1:4] @ rotation.T + base
    rows[:, 4:7] = rows[:, 4:7] @ rotation.T
    return rows


@compiled
def trace(
    layout: Layout, alpha: Array, beta: Array, world_wrench: Array, contact: float, more: Array, unknowns: Array,
    step: float, path: Array,
) -> None:  # fmt: skip
    """Write the centre line of solved `unknowns` to `path` (m, 7), in the plate's axes; `more` as `Loads.rows`."""
    q = layout.counts.shape[0]
    wrench = to_plate(layout, world_wrench)
    y, ends = np.empty(9 + 2 * q), np.empty(q + 2)
    _integrate(layout, alpha, beta, wrench, contact, more, unknowns, step, y, ends, path)


@compiled
def _integrate(
    layout: Layout, alpha: Array, beta: Array, wrench: Array, contact: float, more: Array, unknowns: Array,
    step: float, y: Array, ends: Array, path: Array,
) -> None:  # fmt: skip
    """Integrate from the plate to the last tube end, in the plate's axes; `ends` (q + 2) receives the end conditions.

    `y` receives frame and position of the tip. The force of the wrench acts at `contact` (inf: at the tip; beyond the
    last tube end: at this end), its moment at the tip; `more` are further loads, as `Loads.rows`. `path` (m, 7)
    receives the centre line as `put_point` writes it; it may have no rows.
    """
    force = wrench.copy()  # force beyond the current cross-section; only the first three elements are used
    q = layout.counts.shape[0]
    section, memory = np.zeros(q, np.int64), np.zeros((3, q))
    bend, twist, ratio = memory[0], memory[1], memory[2]
    curvature, turn = np.zeros((q, 2)), np.empty((q, 2))
    start_state(layout, alpha, beta, unknowns, y, section)
    stages, rotation, tip, axial, at_tip = np.empty((5, y.size)), np.empty((3, 3)), np.empty(7), 0.0, False
    k1, k2, k3, k4, at = stages[0], stages[1], stages[2], stages[3], stages[4]
    start = 0.0
    count = put_point(path, 0, 0.0, y)
    points = max(more.shape[0] - 1 - q, 0)
    point, pull = 0, np.zeros(3)  # next point load, and distributed load of the current link [N/m]
    if more.shape[0] > 0:
        _add_loads(layout, beta, more, points, force)
    while True:
        if section[0] == layout.counts[0] and not at_tip:
            at_tip = True
            copy(y[:7], tip)
            if contact == np.inf:
                for k in range(3):
                    force[k] -= wrench[k]
            _rotation(y, rotation)
            for i in range(2):
                y[7 + i] -= rotation[0, i] * wrench[3] + rotation[1, i] * wrench[4] + rotation[2, i] * wrench[5]
            axial = rotation[0, 2] * wrench[3] + rotation[1, 2] * wrench[4] + rotation[2, 2] * wrench[5]
        end, end_tube, total = present(layout, beta, section, bend, twist, ratio, curvature)
        if end_tube < 0:
            break
        if start <= contact < end:
            end, end_tube = contact, -1
        if point < points and more[point, 0] < end:
            end, end_tube = more[point, 0], -2
        steps = int(np.ceil((end - start) / step))
        h = (end - start) / max(steps, 1)
        softness = 1.0 / total
        if more.shape[0] > 0:
            _pull(layout, more, points, bend, pull)
        for number in range(steps):
            slope(y, k1, turn, bend, twist, ratio, curvature, softness, force)
            for i in range(y.size):
                at[i] = y[i] + 0.5 * h * k1[i]
            for k in range(3):
                force[k] -= 0.5 * h * pull[k]
            slope(at, k2, turn, bend, twist, ratio, curvature, softness, force)
            for i in range(y.size):
                at[i] = y[i] + 0.5 * h * k2[i]
            slope(at, k3, turn, bend, twist, ratio, curvature, softness, force)
            for i in range(y.size):
                at[i] = y[i] + h * k3[i]
            for k in range(3):
                force[k] -= 0.5 * h * pull[k]
            slope(at, k4, turn, bend, twist, ratio, curvature, softness, force)
            for i in range(y.size):
                y[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
            count = put_point(path, count, start + (number + 1) * h, y)
        start = end
        if end_tube >= 0:
            section[end_tube] += 1
        elif end_tube == -1:
            contact = -np.inf  # the point of the force has been passed
            for k in range(3):
                force[k] -= wrench[k]
        else:
            _subtract(layout, more[point], force)
            point += 1
    ends[0], ends[1] = y[7], y[8]
    for i in range(q):
        ends[2 + i] = y[9 + i]
    copy(tip, y[:7])
    ends[2] -= axial * layout.stiffness[0, 1] / layout.stiffness[0, 0]


@compiled
def _subtract(layout: Layout, row: Array, force: Array) -> None:
    """Subtract the force (world frame) of a row of `Loads.rows` from `force` (plate's axes)."""
    for i in range(3):
        for k in range(3):
            force[i] -= layout.base[3 * k + i] * row[1 + k]


@compiled
def _pull(layout: Layout, more: Array, points: int, bend: Array, pull: Array) -> None:
    """Write the force per length (3,) of a link whose tubes have the bending stiffness `bend` (q,), plate's axes."""
    pull[:] = 0.0
    _subtract(layout, more[points], pull)
    for i in range(bend.shape[0]):
        if bend[i] > 0.0:
            _subtract(layout, more[points + 1 + i], pull)
    for k in range(3):
        pull[k] = -pull[k]


@compiled
def _add_loads(layout: Layout, beta: Array, more: Array, points: int, force: Array) -> None:
    """Add all loads of `Loads.rows` beyond the plate to `force`, plate's axes."""
    row = np.zeros(4)
    for load in range(more.shape[0]):
        length = -1.0
        if load == points:
            length = -farthest_end(layout, beta)
        elif load > points:
            i = load - points - 1
            length = -max(beta[i] + layout.ends[i, layout.counts[i] - 1], 0.0)
        for k in range(1, 4):
            row[k] = length * more[load, k]
        _subtract(layout, row, force)


@compiled
def shoot(
    layout: Layout, alpha: Array, beta: Array, world_wrench: Array, contact: float, more: Array, guess: Array,
    chord: Array, step: float, tolerance: float,
) -> tuple[Array, Array, Array, Array, int, float]:  # fmt: skip
    """Solve for the unknowns with the chord method: Newton steps that reuse the inverse derivative (the chord).

    The derivative is computed by differences, and recomputed when convergence is slow.

    Returns unknowns, chord, tip, frame, number of integrations and the residual of the end conditions at that tip. A
    residual above `tolerance` means failure. The returned unknowns include one more chord step, so that later guesses
    computed from them do not contain the tolerated error.
    """
    q = layout.counts.shape[0]
    size = q + 2
    wrench = to_plate(layout, world_wrench)
    y, ends, moved, correction = np.empty(9 + 2 * q), np.empty(size), np.empty(size), np.empty(size)
    unknowns, trial, inverse, nowhere = guess.copy(), guess.copy(), chord.copy(), np.empty((0, 7))
    _integrate(layout, alpha, beta, wrench, contact, more, unknowns, step, y, ends, nowhere)
    residual = largest(ends)
    iterations = 1
    recompute = not inverse.any()
    while residual > tolerance and iterations < 60:
        if recompute:
            matrix = np.empty((size, size))
            for k in range(size):
                copy(unknowns, trial)
                trial[k] += 1e-6
                _integrate(layout, alpha, beta, wrench, contact, more, trial, step, y, moved, nowhere)
                for i in range(size):
                    matrix[i, k] = (moved[i] - ends[i]) / 1e-6
            if not 1e-30 <= abs(_determinant(matrix.copy())) < np.inf:
                return unknowns, inverse, *to_world(layout, y), iterations, np.inf
            renewed = np.linalg.inv(matrix)
            for k in range(size):
                copy(renewed[k], inverse[k])
        times(inverse, ends, correction)
        fraction = 1.0
        while True:
            for i in range(size):
                trial[i] = unknowns[i] - fraction * correction[i]
            _integrate(layout, alpha, beta, wrench, contact, more, trial, step, y, moved, nowhere)
            iterations += 1
            after = largest(moved)
            if after < residual or (not recompute) or fraction < 1e-3:
                break
            fraction *= 0.5
        if after < residual:
            recompute = after > 0.1 * residual
            copy(trial, unknowns)
            copy(moved, ends)
            residual = after
        elif recompute:
            break
        else:
            recompute = True
    times(inverse, ends, correction)
    for i in range(size):
        unknowns[i] -= correction[i]
    return unknowns, inverse, *to_world(layout, y), iterations, residual


@compiled
def _determinant(matrix: Array) -> float:
    """Return the determinant by elimination, which overwrites the matrix; NaN if the matrix contains one."""
    size, determinant = matrix.shape[0], 1.0
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if matrix[pivot, k] == 0.0:
            return 0.0
        for j in range(k, size):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        determinant *= matrix[k, k] if pivot == k else -matrix[k, k]
        for i in range(k + 1, size):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, size):
                matrix[i, j] -= factor * matrix[k, j]
    return determinant


@compiled
def largest(values: Array) -> float:
    """Return the largest magnitude; NaN if any value is NaN."""
    largest = 0.0
    for i in range(values.size):
        if not abs(values[i]) <= largest:
            largest = abs(values[i])
        if np.isnan(largest):
            break
    return largest


@compiled
def times(matrix: Array, vector: Array, out: Array) -> None:
    """Write matrix times vector to `out`; the loop is faster than a library call for small matrices."""
    for i in range(out.size):
        out[i] = 0.0
        for k in range(vector.size):
            out[i] += matrix[i, k] * vector[k]
