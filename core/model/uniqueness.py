"""Sufficient test whether a robot has only one shape at given translations, for all rotations and force directions.

If the robot has only one shape, Newton's method may start from any guess: it can only find this shape, which is stable.
The test shows that the second variation of the robot's energy is positive at every equilibrium. The energy is the
elastic energy minus the work of the force F on the tip. Its variables are the curvature k(s) of the curve that all
tubes share, and the rotation theta_i(s) of each tube i; s is the arc length. These variables are independent of each
other. For changes dk and psi_i of k and theta_i, the second variation is

    int B |dk|^2 - 2 dk . v + sum EI_i psi_i^2 k . w_i + sum GJ_i psi_i'^2 ds + sum GJ_i psi_i(0)^2 / -beta_i - F . d2r

Here w_i is the precurvature of tube i, w_i' its derivative by theta_i, v = sum EI_i psi_i w_i', B = sum EI_i, d2r the
second variation of the tip's position, and -beta_i the length of tube i behind the plate. At any equilibrium of a robot
of length L, B k = sum EI_i w_i + M with a moment |M| <= |F| (L - s). Also |d2r| <= int y^2 ds with y' = |dk|. Therefore
the second variation is at least

    int (B y' - V)^2 / B - |F| y^2 + sum GJ_i p_i'^2 - sum_{i<j} EI_i EI_j / B |w_i| |w_j| (p_i + p_j)^2
        - sum EI_i |w_i| |F| (L - s) / B p_i^2 ds + sum GJ_i p_i(0)^2 / -beta_i,
    p_i = |psi_i|, V = sum EI_i |w_i| p_i.

This lower bound does not depend on the shape. If the bound is positive, every equilibrium is a strict minimum of the
energy. Between two minima there would be a saddle, which is an equilibrium but not a minimum. So there is only one
equilibrium. Without `SAFETY_FACTOR`, the bound reproduces two known limits: for two tubes without load the
snap condition of `robot.strength`, and for a single straight tube Euler's buckling load.
"""

import numpy as np

from core.compiled import compiled
from core.robot.robot import FLUSH_TOLERANCE_M, Array, Layout, farthest_end

#: Largest length of an element of the discretised energy, in metres [m] and as a fraction of the robot's length.
MAX_ELEMENT_M, MAX_ELEMENT_SHARE = 0.025, 0.1
#: Factor on the negative terms of the energy's second variation, a reserve for the errors of elements and sub-links.
SAFETY_FACTOR = 1.1
#: Stiffness that represents a clamped end, divided by the stiffness of the clamped tubes [1/m].
CLAMP_STIFFNESS = 1e9


@compiled
def is_unique(layout: Layout, beta: Array, force: float, contact: float, tubes: tuple[float, ...]) -> bool:
    """Return whether a proof exists that the robot has exactly one shape, and that it is stable.

    Args:
        layout: the robot.
        beta: proximal ends of the tubes (q,) [m].
        force: largest size of the force, in any direction [N].
        contact: arc length from the plate at which the force acts [m]; inf for the tip.
        tubes: a tuple whose length is the number of tubes q, see `propagation.propagate`.

    Returns:
        True if the test proves uniqueness and stability; False leaves both open.

    """
    q = len(tubes)
    size = q + 1  # unknowns at a cross-section: y, and p of each tube
    carried, form = np.zeros((size, size)), np.zeros((2 * size, 2 * size))
    section = np.zeros(q, np.int64)
    bend, pull = np.empty(q), np.empty(q)
    tip, length = beta[0] + layout.ends[0, layout.counts[0] - 1], farthest_end(layout, beta)
    reach = length if tip < contact < np.inf else tip  # at the point where the force acts, or beyond it
    carried[0, 0] = CLAMP_STIFFNESS * layout.stiffness[0, 0]
    for i in range(q):
        twist = layout.stiffness[i, 0] / layout.stiffness[i, 1]
        carried[1 + i, 1 + i] = twist * min(CLAMP_STIFFNESS, 1.0 / max(-beta[i], 1.0 / CLAMP_STIFFNESS))
        while section[i] < layout.counts[i] and beta[i] + layout.ends[i, section[i]] <= 0.0:
            section[i] += 1
    start = 0.0
    while True:
        end, end_tube, total = np.inf, -1, 0.0
        for i in range(q):
            bend[i], pull[i] = 0.0, 0.0
            if section[i] < layout.counts[i]:
                section_end = beta[i] + layout.ends[i, section[i]]
                if section_end < end + FLUSH_TOLERANCE_M:
                    end, end_tube = section_end, i
                bend[i] = layout.stiffness[i, 0]
                x, y = layout.curvatures[i, section[i], 0], layout.curvatures[i, section[i], 1]
                pull[i] = bend[i] * np.sqrt(x * x + y * y)
                total += bend[i]
        if end_tube < 0:
            form[:] = 0.0
            return _is_positive(carried, form, size)
        section[end_tube] += 1
        if end - start <= FLUSH_TOLERANCE_M:
            continue
        count = int(np.ceil((end - start) / min(MAX_ELEMENT_M, MAX_ELEMENT_SHARE * length)))
        h = (end - start) / count
        for number in range(count):
            arm = reach - start - (number + 0.5) * h
            pushed = force if arm > 0.0 else 0.0  # the load does not bend the tubes beyond the force
            _element(form, h, total, bend, pull, layout.stiffness[:, 1], pushed, arm, size)
            if not _is_positive(carried, form, size):
                return False
        start = end


@compiled
def _element(
    form: Array, h: float, total: float, bend: Array, pull: Array, ratio: Array, force: float, arm: float, size: int
) -> None:
    """Write the lower bound of one element to `form`: a quadratic form in y and p_i at its two ends (2 (q + 1))."""
    form[:] = 0.0
    # Weights of y', y and p in the middle of the element, expressed by the values at both ends.
    even, odd = 0.25 * h, 1.0 / h
    _put(form, 0, 0, size, -SAFETY_FACTOR * force * even, total * odd)
    for i in range(size - 1):
        if bend[i] == 0.0:
            form[size + 1 + i, size + 1 + i] = total  # an absent tube adds nothing
            continue
        level = pull[i] * pull[i] / total - SAFETY_FACTOR * pull[i] * force * arm / total
        for j in range(size - 1):
            if j != i:
                level -= SAFETY_FACTOR * pull[i] * pull[j] / total
                across = (1.0 - SAFETY_FACTOR) * pull[i] * pull[j] / total
                _put(form, 1 + i, 1 + j, size, even * across, 0.0)
        _put(form, 1 + i, 1 + i, size, even * level, bend[i] / ratio[i] * odd)
        half = 0.5 * pull[i]
        for side in range(2):
            sign = -half if side == 1 else half
            for other in range(2):
                form[side * size, other * size + 1 + i] += sign
                form[other * size + 1 + i, side * size] += sign


@compiled
def _put(form: Array, i: int, j: int, size: int, even: float, odd: float) -> None:
    """Add 4 `even` times the product of variables i and j mid-element, plus `odd` times that of their differences."""
    form[i, j] += even + odd
    form[i, size + j] += even - odd
    form[size + i, j] += even - odd
    form[size + i, size + j] += even + odd


@compiled
def _is_positive(carried: Array, form: Array, size: int) -> bool:
    """Eliminate the unknowns at an element's proximal end, and return whether all pivots are positive.

    `carried` is the form that remains of all elements before; it is replaced by the form at the element's distal end.
    """
    for i in range(size):
        for j in range(size):
            form[i, j] += carried[i, j]
    for k in range(size):
        if not form[k, k] > 0.0:
            return False
        inverse = 1.0 / form[k, k]
        for i in range(k + 1, 2 * size):
            factor = form[i, k] * inverse
            for j in range(k + 1, 2 * size):
                form[i, j] -= factor * form[k, j]
    for i in range(size):
        for j in range(size):
            carried[i, j] = form[size + i, size + j]
    return True
