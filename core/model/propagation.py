"""One pass along the tubes: the loaded model, eqs. (6)-(16), and its derivatives, eqs. (17)-(19).

The end of every tube section starts a new link. Links consist of sub-links of one length; the last sub-link of each
link takes the remainder. A sub-link is one step of an integrator: `second_order` is the paper's integrator,
`fourth_order` permits longer steps.

The tip is the end of the innermost tube. If outer tubes reach beyond the tip, the pass continues to their ends, because
their torsion there is an end condition; then it returns to the frame and position of the tip. These tubes carry a load
only if the force acts on them, beyond the tip.

The derivatives of the state are integrated together with it, one column for each base unknown (u_iz(0), M(0)), joint
and force component. If a joint changes the length of a link, only the link's last sub-link changes (H in (19)).
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.model.integrators import fourth_order, second_order
from core.robot.robot import FLUSH_TOLERANCE_M, Array, Layout

#: Rows of a derivative column before those of the tubes: rotation (3) and position (3), world frame.
FRAME_ROWS = 6
#: Rows of a derivative column after those of the tubes: force (3), moment at the plate (3), and dh, the change of the
#: length of a link's last sub-link. They are constant along a link.
FIXED_ROWS = 7

#: Order of the integrators by name.
INTEGRATORS = {"paper": 2, "fourth_order": 4}


class Scheme(NamedTuple):
    """Discretisation of the tubes: order of the integrator and length of its steps."""

    order: int  #: 2 or 4, see `INTEGRATORS`
    sublink: float  #: length of a sub-link [m]; the last sub-link of each link takes the remainder


@compiled
def propagate(
    layout: Layout,
    scheme: Scheme,
    alpha: Array,
    beta: Array,
    wrench: Array,
    contact: float,
    unknowns: Array,
    tubes: tuple[float, ...],
    columns: tuple[float, ...],
    state: Array,
    rates: Array,
    path: Array,
) -> int:
    """Integrate the model from the plate to the last tube end, with its derivatives.

    Args:
        layout: the robot.
        scheme: order of the integrator and length of a sub-link.
        alpha, beta: rotation [rad] and proximal end [m] of each tube (q,).
        wrench: force and moment (6,), world frame [N, N m]; the moment acts at the tip.
        contact: arc length from the plate at which the force acts [m]; inf for the tip.
        unknowns: u_iz(0) of each tube (q) [1/m], then M(0) (3), about the plate [N m].
        tubes, columns: tuples whose lengths are constants to the compiler: q, and the number of derivative columns (0
            for none, else rounded up to a multiple of 4, see `Statics`).
        state: out (18 + 2q): R by rows and r from the plate [m] at the tip; theta_i [rad], u_iz [1/m] at the end
            of each tube; then the remaining force and M about the plate at the tip. Where the force acts beyond the
            tip: no force, and M at the last tube end plus the moment at the tip.
        rates: out (rows x columns, flat): derivatives of rotation (3, world), r (3), theta_i,
            u_iz, force, M by unknowns (q + 3), joints (n), force (3).
        path: out (m, 16 + 2q): arc length, R, r, theta_i, u_iz, M at the start of every sub-link and at the last
            tube end; only the first m cross-sections are written.

    Returns:
        Number of cross-sections passed, including those at the plate and at the last tube end.

    """
    q, width, n = len(tubes), len(columns), layout.joint_tube.shape[0]
    first_joint, first_force = q + 3, q + 3 + n
    fixed = (FRAME_ROWS + 2 * q) * width
    link, load = np.zeros((q, 5)), state[12 + 2 * q :]
    section = np.zeros(q, np.int64)
    for k in range(9):
        state[k] = layout.base[k]
    for k in range(3):
        state[9 + k], load[k], load[3 + k] = 0.0, wrench[k], unknowns[q + k]
    for i in range(q):
        state[12 + q + i] = unknowns[i]
        state[12 + i] = alpha[i] - beta[i] * unknowns[i]  # the length -beta_i behind the plate twists by -beta_i u_iz
        # Skip sections that end behind the plate or, whatever the rounding, flush with it. The last section of a tube
        # stays as a link of length zero: the derivatives by the tube's translation come from its end.
        while section[i] < layout.counts[i] - 1 and beta[i] + layout.ends[i, section[i]] <= FLUSH_TOLERANCE_M:
            section[i] += 1
    if width > 0:
        rates[:] = 0.0
        for i in range(q):
            rates[(FRAME_ROWS + i) * width + i] = -beta[i]
            rates[(FRAME_ROWS + q + i) * width + i] = 1.0
        for j in range(n):
            i = layout.joint_tube[j]
            turn = -unknowns[i] if layout.joint_slides[j] else 1.0
            rates[(FRAME_ROWS + i) * width + first_joint + j] = turn
        for k in range(3):
            rates[fixed + k * width + first_force + k] = 1.0
            rates[fixed + (3 + k) * width + q + k] = 1.0

    start = 0.0
    start_tube = -1  # tube whose beta moves the start of this link; -1: the plate, which does not move
    passed = 0
    at_tip, retracted, beyond = link[0], False, False  # set at the tip if outer tubes reach beyond it
    while True:
        # This link ends at the next section end or at the force.
        end, end_tube, total = np.inf, -1, 0.0
        for i in range(q):
            if section[i] < layout.counts[i]:
                section_end = beta[i] + layout.ends[i, section[i]]
                # Where tube ends coincide, the outermost of these tubes ends first. The innermost tube thus ends last,
                # and its translation moves the tip, as in poses where the innermost tube extends beyond the others.
                if section_end < end + FLUSH_TOLERANCE_M:
                    end, end_tube = section_end, i
                total += layout.stiffness[i, 0]
        if end_tube < 0:
            break
        if contact < end:
            end, end_tube = contact, -1
        for i in range(q):
            link[i, 4] = 1.0 / total
            if section[i] < layout.counts[i]:
                link[i, 0], link[i, 1] = layout.stiffness[i, 0] / total, layout.stiffness[i, 1]
                link[i, 2], link[i, 3] = layout.curvatures[i, section[i], 0], layout.curvatures[i, section[i], 1]
            else:
                link[i, 0], link[i, 1], link[i, 2], link[i, 3] = 0.0, 0.0, 0.0, 0.0
        span = end - start
        steps = max(1, int(np.ceil(span / scheme.sublink)))
        if width > 0:
            for j in range(n):
                if layout.joint_slides[j]:
                    i = layout.joint_tube[j]
                    rate = (1.0 if i == end_tube else 0.0) - (1.0 if i == start_tube else 0.0)
                    rates[fixed + 6 * width + first_joint + j] = rate
        for step in range(steps):
            last = step == steps - 1
            h = span - (steps - 1) * scheme.sublink if last else scheme.sublink
            if passed < path.shape[0]:
                _record(path[passed], start + step * scheme.sublink, state, q)
            passed += 1
            if scheme.order == 4:
                fourth_order(link, load, h, 1.0 if last else 0.0, state, rates, tubes, columns)
            else:
                second_order(link, load, h, 1.0 if last else 0.0, state, rates, tubes, columns)
        start, start_tube = end, end_tube
        if end_tube >= 0:
            section[end_tube] += 1
            if end_tube == 0 and section[0] == layout.counts[0] and total > layout.stiffness[0, 0]:
                retracted, beyond = True, contact < np.inf
                at_tip = _leave_tip(load, state, rates, fixed, width, beyond)
                for k in range(3 if beyond else 0):
                    load[3 + k] -= wrench[3 + k]
        else:
            contact = np.inf
            _leave_force(load, state, rates, fixed, width)

    if passed < path.shape[0]:
        _record(path[passed], start, state, q)
    if retracted:
        if beyond:
            _leave_force(load, state, rates, fixed, width)  # no change if the force acts before the last tube end
        _return_to_tip(at_tip, load, state, rates, fixed, width, beyond)
        for k in range(3 if beyond else 0):
            load[3 + k] += wrench[3 + k]
    for k in range(3):
        j, m = (k + 1) % 3, (k + 2) % 3
        load[3 + k] -= state[9 + j] * load[m] - state[9 + m] * load[j]
    return passed + 1


@compiled
def repeat(
    layout: Layout,
    scheme: Scheme,
    alpha: Array,
    beta: Array,
    wrench: Array,
    contact: float,
    unknowns: Array,
    tubes: tuple[float, ...],
    columns: tuple[float, ...],
    times: int,
) -> None:
    """Integrate along the tubes `times` times, for benchmarks."""
    q = len(tubes)
    state, rates = np.empty(18 + 2 * q), np.empty((FRAME_ROWS + 2 * q + FIXED_ROWS) * len(columns))
    path = np.empty((0, 0))
    for _ in range(times):
        propagate(layout, scheme, alpha, beta, wrench, contact, unknowns, tubes, columns, state, rates, path)


@compiled
def _leave_force(load: Array, state: Array, rates: Array, fixed: int, width: int) -> None:
    """Set the force to zero beyond its contact, and subtract its moment about the plate."""
    for k in range(3):
        j, m = (k + 1) % 3, (k + 2) % 3
        load[3 + k] -= state[9 + j] * load[m] - state[9 + m] * load[j]
        for col in range(width):
            dj, dm = rates[(3 + j) * width + col], rates[(3 + m) * width + col]
            fj, fm = rates[fixed + j * width + col], rates[fixed + m * width + col]
            rates[fixed + (3 + k) * width + col] -= dj * load[m] - dm * load[j] + state[9 + j] * fm - state[9 + m] * fj
    load[:3] = 0.0
    rates[fixed : fixed + 3 * width] = 0.0


@compiled
def _leave_tip(load: Array, state: Array, rates: Array, fixed: int, width: int, beyond: bool) -> Array:
    """Return frame, position, load and their derivatives at the tip; set the load to zero unless it acts beyond.

    Without a force beyond the tip, the moment there is zero in every solution, so it does not depend on the unknowns.
    """
    kept = np.empty(18 + 12 * width)
    copy(state[:12], kept[:12])
    copy(load[:6], kept[12:18])
    copy(rates[: 6 * width], kept[18 : 18 + 6 * width])
    copy(rates[fixed : fixed + 6 * width], kept[18 + 6 * width :])
    if not beyond:
        load[:6] = 0.0
        rates[fixed : fixed + 6 * width] = 0.0
    return kept


@compiled
def _return_to_tip(kept: Array, load: Array, state: Array, rates: Array, fixed: int, width: int, beyond: bool) -> None:
    """Write the values from `_leave_tip` back to state and rates; the load only if no load acts beyond the tip."""
    copy(kept[:12], state[:12])
    copy(kept[18 : 18 + 6 * width], rates[: 6 * width])
    if not beyond:
        copy(kept[12:18], load[:6])
        copy(kept[18 + 6 * width :], rates[fixed : fixed + 6 * width])


@compiled
def _record(row: Array, s: float, state: Array, q: int) -> None:
    row[0] = s
    for k in range(12 + 2 * q):
        row[1 + k] = state[k]
    for k in range(3):
        j, m = (k + 1) % 3, (k + 2) % 3
        force, moment = state[12 + 2 * q : 15 + 2 * q], state[15 + 2 * q + k]
        row[13 + 2 * q + k] = moment - (state[9 + j] * force[m] - state[9 + m] * force[j])
