"""Whether a robot can have but one shape where its tubes stand, whichever way they are turned and the force points.

Then Newton may begin anywhere: what it finds is the shape that the robot comes to from rest, and stable. In the
variables of `relaxation`, the curvature k of the common curve and the rotations theta_i, which no condition ties to
each other, the elastic energy changes to second order by

    int B |dk|^2 - 2 dk . v + sum EI_i psi_i^2 k . w_i + sum GJ_i psi_i'^2 ds + sum GJ_i psi_i(0)^2 / -beta_i - F . d2r

with w_i the precurvature of tube i, w_i' its rate by theta_i, v = sum EI_i psi_i w_i' and B = sum EI_i. At any shape
that is in balance B k = sum EI_i w_i + M, |M| <= |F| (L - s), and |d2r| <= int y^2 with y' = |dk|. So it is at least

    int (B y' - V)^2 / B - |F| y^2 + sum GJ_i p_i'^2 - sum_{i<j} EI_i EI_j / B |w_i| |w_j| (p_i + p_j)^2
        - sum EI_i |w_i| |F| (L - s) / B p_i^2 ds + sum GJ_i p_i(0)^2 / -beta_i,
    p_i = |psi_i|, V = sum EI_i |w_i| p_i,

which knows no shape any more. Where this form is positive every shape in balance is a strict minimum of the energy,
and between two minima there would have to be a pass: there is only one. Without load and for two tubes this is the
condition that a design does not snap (`robot.stability`), with a straight tube alone it is Euler's load.
"""

import numpy as np

from core.compiled import compiled
from core.robot.robot import FLUSH, Array, Layout

#: Longest element of the form [m], and its longest part of the tubes.
ELEMENT, PART = 0.025, 0.1
#: What pulls down counts so much more, for what elements and sub-links leave.
RESERVE = 1.1
#: What holds a clamped end, over the stiffness it holds [1/m].
CLAMP = 1e9


@compiled
def only_shape(layout: Layout, beta: Array, force: float, tubes: tuple[float, ...]) -> bool:
    """Whether there is one shape only, and it is stable.

    Args:
        layout: the robot.
        beta: proximal ends at which the tubes stand (q,) [m].
        force: at the tip, in any direction, as far as this [N].
        tubes: a tuple of length q, see `propagation.propagate`.

    Returns:
        False where that is not known.

    """
    q = len(tubes)
    size = q + 1  # unknowns at a place: y, and p of each tube
    held, form = np.zeros((size, size)), np.zeros((2 * size, 2 * size))
    section = np.zeros(q, np.int64)
    bend, pull = np.empty(q), np.empty(q)
    length = beta[0] + layout.ends[0, layout.counts[0] - 1]
    held[0, 0] = CLAMP * layout.stiffness[0, 0]
    for i in range(q):
        twist = layout.stiffness[i, 0] / layout.stiffness[i, 1]
        held[1 + i, 1 + i] = twist * min(CLAMP, 1.0 / max(-beta[i], 1.0 / CLAMP))
        while section[i] < layout.counts[i] and beta[i] + layout.ends[i, section[i]] <= 0.0:
            section[i] += 1
    start = 0.0
    while True:
        end, end_tube, total = np.inf, -1, 0.0
        for i in range(q):
            bend[i], pull[i] = 0.0, 0.0
            if section[i] < layout.counts[i]:
                place = beta[i] + layout.ends[i, section[i]]
                if place < end + FLUSH:
                    end, end_tube = place, i
                bend[i] = layout.stiffness[i, 0]
                x, y = layout.curvatures[i, section[i], 0], layout.curvatures[i, section[i], 1]
                pull[i] = bend[i] * np.sqrt(x * x + y * y)
                total += bend[i]
        if end_tube < 0:
            form[:] = 0.0
            return _passed(held, form, size)
        section[end_tube] += 1
        if end - start <= FLUSH:
            continue
        count = int(np.ceil((end - start) / min(ELEMENT, PART * length)))
        h = (end - start) / count
        for number in range(count):
            arm = length - start - (number + 0.5) * h
            _element(form, h, total, bend, pull, layout.stiffness[:, 1], force, arm, size)
            if not _passed(held, form, size):
                return False
        start = end


@compiled
def _element(
    form: Array, h: float, total: float, bend: Array, pull: Array, ratio: Array, force: float, arm: float, size: int
) -> None:
    """The form of one element by the unknowns at its two ends (2 (q + 1), square)."""
    form[:] = 0.0
    # y', y and p in the middle, by the values at both ends.
    even, odd = 0.25 * h, 1.0 / h
    _put(form, 0, 0, size, -RESERVE * force * even, total * odd)
    for i in range(size - 1):
        if bend[i] == 0.0:
            form[size + 1 + i, size + 1 + i] = total  # a tube that is not there says nothing
            continue
        level = pull[i] * pull[i] / total - RESERVE * pull[i] * force * arm / total
        for j in range(size - 1):
            if j != i:
                level -= RESERVE * pull[i] * pull[j] / total
                across = (1.0 - RESERVE) * pull[i] * pull[j] / total
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
    """(value i) (value j) with weight 4 `even`, and the differences' product with weight `odd`."""
    form[i, j] += even + odd
    form[i, size + j] += even - odd
    form[size + i, j] += even - odd
    form[size + i, size + j] += even + odd


@compiled
def _passed(held: Array, form: Array, size: int) -> bool:
    """Eliminate the near end of an element; False where the form falls. `held` goes on to the far end."""
    for i in range(size):
        for j in range(size):
            form[i, j] += held[i, j]
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
            held[i, j] = form[size + i, size + j]
    return True
