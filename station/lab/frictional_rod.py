"""The exact rod with effects of real hardware: friction and clearance between the tubes, weight, and base reactions.

At a tube's end, and where a tube's precurvature changes, the tube's bending moment jumps by dM. Its neighbour transfers
this jump by a couple: two contact forces dM / d, a length d apart. These forces cause friction of at most

    T = 2 mu |dM| / d                                   (Lock and Dupont 2011: |tau| <= c |dM|, c = 2 mu r / d)

between neighbouring tubes, with the friction coefficient mu and the contact radius r. Friction resists both relative
rotation (by a torque r T about the tangent) and sliding. Along the relative path x it follows Dahl's law

    dT = (T_max dx - T |dx|) / x_s

so it depends on the past motion, not on time. The torque causes a jump of GJ u_z in the torsion of both tubes.
Therefore torque and shape are solved together.

Clearance (Ha, Fagogenis and Dupont 2019): the inner tubes bend freely over the last part of the outer tube. This part
has the length d = sqrt(6 g / du), in which tubes whose curvatures differ by du cross the gap g. The inner tubes leave
the outer tube at the angle du_bundle d / 2; du_bundle is the change of the bundle's curvature at the outer tube's end.

Each base carries one tube: the tube's bending moment K_i (u - u_i^), torque GJ_i u_iz and shear t x m_i' at the plate,
and a force along z. The force along z follows from the invariant n_i . t + m_i . u_i - W_i, where W_i is the elastic
energy per length. The invariant is constant along a tube whose neighbours push only perpendicular to the tube. It
changes only at the tube's end, at steps of its precurvature, and by friction and weight.
"""

from typing import NamedTuple

import numpy as np

from core.compiled import compiled, copy
from core.model.cosserat import largest, present, put_point, slope, start_state, times, to_plate, to_world
from core.robot.robot import Array, Layout


@compiled
def dahl_friction(
    limit: float, stick: float, radius: float, turned: float, slid: float, old: Array, new: Array
) -> None:
    """Compute the Dahl friction `new` after a motion of the inner tube relative to the outer one, from `old` before it.

    `old` and `new` have four numbers: friction force about and along the tangent [N], relative angle [rad], and a flag
    that is 1 after the first call. `turned` is the current relative angle [rad], and `slid` is the sliding distance
    since the previous tick [m]. `limit` is the largest friction force [N], `stick` the path over which friction
    reverses [m], and `radius` the contact radius [m].
    """
    new[2], new[3] = turned, 1.0
    if old[3] == 0.0:
        new[0] = new[1] = 0.0
        return
    about, along = radius * (turned - old[2]), slid
    distance = np.sqrt(about * about + along * along)
    decay, toward = np.exp(-distance / stick), 0.0
    if distance > 0.0:
        toward = limit * (1.0 - decay) / distance
    new[0], new[1] = toward * about + decay * old[0], toward * along + decay * old[1]
    # The limit falls with the normal force. The previous friction may then exceed the limit and is reduced to it.
    size = np.sqrt(new[0] * new[0] + new[1] * new[1])
    if size > limit:
        new[0] *= limit / size
        new[1] *= limit / size


class FrictionContact(NamedTuple):
    """Parameters of the contact between tubes, and their weight."""

    grip: float  #: 2 mu / d: largest friction force per transferred moment [1/m]
    stick: float  #: x_s, path over which friction reverses [m]
    gap: float  #: difference of the facing diameters [m]
    radius: Array  #: (q,) contact radius of each tube with the tube around it [m]
    weight: Array  #: (q,) weight of each tube per length [N/m]
    gravity: Array  #: (3,) direction of gravity, unit vector in the plate's axes


@compiled
def slots(layout: Layout) -> int:
    """Return the number of friction slots: one for each pair of neighbours and each section end of each tube."""
    q, k = layout.ends.shape
    return max(q - 1, 1) * q * k


@compiled
def _bend(y: Array, curvature: Array, bend: Array, softness: float, u: Array, moments: Array) -> None:
    """Write the bundle's curvature to `u` (2,), the bending moments to `moments` (q, 2); axes of the innermost tube."""
    q = bend.shape[0]
    u[0], u[1] = y[7], y[8]
    for i in range(q):
        if bend[i] > 0.0:
            cos, sin = np.cos(y[9 + q + i]), np.sin(y[9 + q + i])
            moments[i, 0] = cos * curvature[i, 0] - sin * curvature[i, 1]
            moments[i, 1] = sin * curvature[i, 0] + cos * curvature[i, 1]
            u[0] += bend[i] * moments[i, 0]
            u[1] += bend[i] * moments[i, 1]
    u[0] *= softness
    u[1] *= softness
    for i in range(q):
        for k in range(2):
            moments[i, k] = bend[i] * (u[k] - moments[i, k])


@compiled
def _tangent(y: Array, along: Array) -> float:
    """Return the component of the vector `along` (3,), plate's axes, along the rod's tangent at state `y`."""
    w, a, b, c = y[0], y[1], y[2], y[3]
    scale = 2.0 / (w * w + a * a + b * b + c * c)
    return (
        along[0] * scale * (a * c + w * b)
        + along[1] * scale * (b * c - w * a)
        + along[2] * (1.0 - scale * (a * a + b * b))
    )


@compiled
def _kink(y: Array, about_x: float, about_y: float, twist: Array, moments: Array) -> None:
    """Rotate the frame of `y` by a small angle about its x and y axes; every tube's moment stays constant in the world.

    `moments` (q, 2) are the tubes' bending moments before the rotation [N m].
    """
    angle = np.sqrt(about_x * about_x + about_y * about_y)
    if angle < 1e-12:
        return
    half_cos, half_sin = np.cos(0.5 * angle), np.sin(0.5 * angle) / angle
    dx, dy = half_sin * about_x, half_sin * about_y
    w, a, b, c = y[0], y[1], y[2], y[3]
    y[0] = w * half_cos - a * dx - b * dy
    y[1] = w * dx + a * half_cos - c * dy
    y[2] = w * dy + b * half_cos + c * dx
    y[3] = c * half_cos + a * dy - b * dx
    # Components in the rotated frame: Rodrigues' formula with the inverse rotation.
    kx, ky, cos, sin = about_x / angle, about_y / angle, np.cos(angle), np.sin(angle)
    mx, my, mz = y[7], y[8], 0.0
    for i in range(twist.shape[0]):
        if twist[i] > 0.0:
            own = twist[i] * y[9 + i]
            mz += own
            y[9 + i] = (cos * own + sin * (ky * moments[i, 0] - kx * moments[i, 1])) / twist[i]
    dot = (1.0 - cos) * (kx * mx + ky * my)
    y[7] = cos * mx - sin * ky * mz + kx * dot
    y[8] = cos * my + sin * kx * mz + ky * dot


@compiled
def integrate(
    layout: Layout, rough: FrictionContact, alpha: Array, beta: Array, tip_force: Array, contact: float,
    unknowns: Array,
    step: float, slid: Array, old: Array, new: Array, y: Array, ends: Array, bases: Array, path: Array,
) -> None:  # fmt: skip
    """Integrate the rod from the plate to the last tube end, in the plate's axes; the outputs are marked `out` below.

    Args:
        layout: tubes at the current pose.
        rough: friction, clearance and weight of the tubes.
        alpha: rotations of the tubes (q,) [rad].
        beta: proximal ends of the tubes (q,) [m].
        tip_force: external force (3,), plate's axes [N].
        contact: arc length at which `tip_force` acts [m], at most that of the last tube end; inf for the tip.
        unknowns: m_x, m_y [N m] and u_iz [1/m] at the plate (q + 2,).
        step: longest integration step [m].
        slid: displacement of each tube along z since the previous tick (q,) [m].
        old: friction at the previous tick (slots, 4), as in `dahl_friction`.
        new: out, friction at this tick (slots, 4).
        y: out (9 + 2 q,), the state at the tip, as in `cosserat`.
        ends: out (q + 2,), violations of the end conditions.
        bases: out (q, 6), load of each tube on its base: force [N], and moment about the plate's origin [N m].
        path: out (m, 7), centre line as `cosserat.put_point` writes it; it may have no rows.

    """
    q, most_sections = layout.counts.shape[0], layout.ends.shape[1]
    section, memory = np.empty(q, np.int64), np.zeros((3, q))
    theta = start_state(layout, alpha, beta, unknowns, y, section)
    bend, twist, ratio = memory[0], memory[1], memory[2]
    curvature, turn = np.zeros((q, 2)), np.empty((q, 2))
    before, after, u = np.zeros((q, 2)), np.zeros((q, 2)), np.zeros(2)
    bent, step_u = np.zeros(2), np.zeros(2)
    pull = np.zeros(q)
    remaining = 0.0  # weight beyond the plate [N]
    for i in range(q):
        remaining += rough.weight[i] * max(beta[i] + layout.ends[i, layout.counts[i] - 1], 0.0)
    new[:] = 0.0
    force, load = np.zeros(3), tip_force.copy()
    stages = np.empty((5, y.size))
    k1, k2, k3, k4, at = stages[0], stages[1], stages[2], stages[3], stages[4]
    start, first = 0.0, True
    count = put_point(path, 0, 0.0, y)
    tip, retracted = y[:7].copy(), section[0] == layout.counts[0]  # whether outer tubes reach beyond the tip
    if retracted and contact == np.inf:
        pull[0] += _tangent(y, load)
        load[:] = 0.0
    end, end_tube, total = present(layout, beta, section, bend, twist, ratio, curvature)
    while end_tube >= 0:
        ending = end_tube
        if contact < end:
            end, ending = contact, -1
        steps = int(np.ceil((end - start) / step))
        h = (end - start) / max(steps, 1)
        heavy = 0.0
        for i in range(q):
            if bend[i] > 0.0:
                heavy += rough.weight[i]
        for number in range(steps):
            for k in range(3):
                force[k] = load[k] + (remaining - number * h * heavy) * rough.gravity[k]
            slope(y, k1, turn, bend, twist, ratio, curvature, 1.0 / total, force)
            if first:
                first = False
                _at_plate(bases, y, k1, unknowns, theta, bend, twist, curvature, 1.0 / total, pull)
            for i in range(y.size):
                at[i] = y[i] + 0.5 * h * k1[i]
            for k in range(3):
                force[k] -= 0.5 * h * heavy * rough.gravity[k]
            slope(at, k2, turn, bend, twist, ratio, curvature, 1.0 / total, force)
            for i in range(y.size):
                at[i] = y[i] + 0.5 * h * k2[i]
            slope(at, k3, turn, bend, twist, ratio, curvature, 1.0 / total, force)
            for i in range(y.size):
                at[i] = y[i] + h * k3[i]
            for k in range(3):
                force[k] -= 0.5 * h * heavy * rough.gravity[k]
            slope(at, k4, turn, bend, twist, ratio, curvature, 1.0 / total, force)
            for i in range(y.size):
                y[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
            count = put_point(path, count, start + (number + 1) * h, y)
        remaining -= (end - start) * heavy
        start = end
        if ending < 0:
            # The outermost of the tubes that reach this point carries the force.
            touched = 0
            for i in range(q):
                if bend[i] > 0.0:
                    touched = i
            pull[touched] += _tangent(y, load)
            contact = np.inf
            load[:] = 0.0
            end, end_tube, total = present(layout, beta, section, bend, twist, ratio, curvature)
            continue
        # Bending moments of the tubes before and after the end of this section.
        part, stiffness = section[ending], total
        old_curvature = curvature[ending].copy()
        angle = y[9 + q + ending]
        for k in range(3):
            force[k] = load[k] + remaining * rough.gravity[k]
        invariant = _axial_invariant(y, force, bend, twist, curvature, total, u, before)
        copy(u, bent)
        neighbours = 0
        for i in range(q):
            if bend[i] > 0.0:
                neighbours = i
        section[ending] += 1
        finished = section[ending] == layout.counts[ending]
        ended = bend[ending]
        weight = rough.weight[ending]
        end, end_tube, total = present(layout, beta, section, bend, twist, ratio, curvature)
        if finished:
            for k in range(3):
                pull[ending] += weight * y[4 + k] * rough.gravity[k]
        if end_tube < 0:
            pull[ending] += _tangent(y, load)
            break
        if finished and ending == 0:
            retracted, tip[:] = True, y[:7]
            if contact == np.inf:
                for k in range(3):
                    load[k], force[k] = 0.0, remaining * rough.gravity[k]
        _bend(y, curvature, bend, 1.0 / total, u, after)
        step_u[0], step_u[1] = u[0] - bent[0], u[1] - bent[1]
        if finished:
            # The ending tube's edge presses perpendicular to the inner tubes; the ending tube carries the remaining
            # axial force.
            pull[ending] += invariant
        else:
            cos, sin = np.cos(angle), np.sin(angle)
            dx, dy = curvature[ending, 0] - old_curvature[0], curvature[ending, 1] - old_curvature[1]
            mx, my = 0.5 * (before[ending, 0] + after[ending, 0]), 0.5 * (before[ending, 1] + after[ending, 1])
            pull[ending] -= mx * (cos * dx - sin * dy) + my * (sin * dx + cos * dy)
        transferred_x, transferred_y = 0.0, 0.0
        for p in range(neighbours):
            transferred_x += after[p, 0] - before[p, 0]
            transferred_y += after[p, 1] - before[p, 1]
            slot = (p * q + ending) * most_sections + part
            limit = rough.grip * np.sqrt(transferred_x * transferred_x + transferred_y * transferred_y)
            turned = float(y[9 + q + p] - y[9 + q + p + 1])
            dahl_friction(limit, rough.stick, rough.radius[p], turned, slid[p] - slid[p + 1], old[slot], new[slot])
            torque, along = rough.radius[p] * new[slot, 0], new[slot, 1]
            # `new` is the friction of the inner tube on the outer tube; the inner tube receives the opposite friction.
            for i, sign in ((p, 1.0), (p + 1, -1.0)):
                jump = sign * torque * layout.stiffness[i, 1] / layout.stiffness[i, 0]
                energy = sign * torque * (y[9 + i] + 0.5 * jump)  # change of torsional energy per length [N]
                pull[i] -= energy + sign * along
                if finished:
                    pull[ending] += energy
                y[9 + i] += jump
        if finished:
            size = np.sqrt(step_u[0] * step_u[0] + step_u[1] * step_u[1])
            if rough.gap > 0.0 and size > 0.0:
                # The term 1e-4 keeps `half` finite if the curvature step vanishes, where the kink has no direction.
                half = 0.5 * np.sqrt(6.0 * rough.gap * ended / (stiffness * np.sqrt(size * size + 1e-4)))
                # Over this length, on average half of the transferred moment does not twist the tubes yet.
                for i in range(neighbours + 1):
                    less = (after[i, 0] - before[i, 0]) * bent[1] - (after[i, 1] - before[i, 1]) * bent[0]
                    y[9 + i] += half * less * layout.stiffness[i, 1] / layout.stiffness[i, 0]
                _kink(y, half * step_u[0], half * step_u[1], twist, after)
            pull[ending] -= _axial_invariant(y, force, bend, twist, curvature, total, u, after)
    for i in range(2):
        ends[i] = y[7 + i]
    for i in range(q):
        ends[2 + i] = y[9 + i]
        bases[i, 2] = pull[i]
    if retracted:
        y[:7] = tip


@compiled
def _axial_invariant(
    y: Array, force: Array, bend: Array, twist: Array, curvature: Array, total: float, u: Array, moments: Array
) -> float:
    """Return the invariant n . t + sum(m_i . u_i - W_i) [N]; write curvature and moments to `u` and `moments`."""
    result = _tangent(y, force)
    _bend(y, curvature, bend, 1.0 / total, u, moments)
    for i in range(bend.shape[0]):
        if bend[i] > 0.0:
            mx, my = moments[i, 0], moments[i, 1]
            result += mx * u[0] + my * u[1] - 0.5 * (mx * mx + my * my) / bend[i]
            result += 0.5 * twist[i] * y[9 + i] * y[9 + i]
    return result


@compiled
def _at_plate(
    bases: Array, y: Array, rate: Array, unknowns: Array, theta: float, bend: Array, twist: Array, curvature: Array,
    softness: float, pull: Array,
) -> None:  # fmt: skip
    """Write moment and shear of each tube at the plate to `bases` (q, 6); initialise the axial forces in `pull`."""
    q = bend.shape[0]
    u, moments = np.zeros(2), np.zeros((q, 2))
    _bend(y, curvature, bend, softness, u, moments)
    # u' of the bundle has a part from the moment and a part from precurvatures that rotate with their tubes.
    du = np.array((rate[7], rate[8]))
    own = np.zeros((q, 2))
    for i in range(q):
        if bend[i] > 0.0:
            cos, sin = np.cos(y[9 + q + i]), np.sin(y[9 + q + i])
            own[i, 0] = -rate[9 + q + i] * (sin * curvature[i, 0] + cos * curvature[i, 1])
            own[i, 1] = rate[9 + q + i] * (cos * curvature[i, 0] - sin * curvature[i, 1])
            du[0] += bend[i] * own[i, 0]
            du[1] += bend[i] * own[i, 1]
    turn_cos, turn_sin = np.cos(theta), np.sin(theta)
    for i in range(q):
        bases[i, :] = 0.0
        if bend[i] == 0.0:
            continue
        mx, my, mz = moments[i, 0], moments[i, 1], twist[i] * unknowns[2 + i]
        # m_i' in the frame of the innermost tube, which rotates with u.
        rate_x = bend[i] * (softness * du[0] - own[i, 0]) + u[1] * mz - unknowns[2] * my
        rate_y = bend[i] * (softness * du[1] - own[i, 1]) + unknowns[2] * mx - u[0] * mz
        nx, ny = -rate_y, rate_x
        bases[i, 0], bases[i, 1] = turn_cos * nx - turn_sin * ny, turn_sin * nx + turn_cos * ny
        bases[i, 3], bases[i, 4] = turn_cos * mx - turn_sin * my, turn_sin * mx + turn_cos * my
        bases[i, 5] = mz
        pull[i] -= mx * u[0] + my * u[1] - 0.5 * (mx * mx + my * my) / bend[i]
        pull[i] -= 0.5 * mz * mz / twist[i]


@compiled
def settle(
    layout: Layout, rough: FrictionContact, alpha: Array, beta: Array, world_force: Array, contact: float, guess: Array,
    chord: Array, step: float, tolerance: float, slid: Array, old: Array, new: Array, bases: Array,
) -> tuple[Array, Array, Array, Array, float]:  # fmt: skip
    """Solve the shape by Newton's method with Broyden's updates, as the derivative jumps when friction starts to slide.

    Returns unknowns for the next guess, chord, tip, frame and the residual of the end conditions. A residual above
    `tolerance` means failure. `new` receives friction and `bases` the base loads of the solved shape, in the plate's
    axes.
    """
    q = layout.counts.shape[0]
    size = q + 2
    wrench = np.zeros(6)
    copy(world_force, wrench)
    force = to_plate(layout, wrench)
    y, ends, moved, correction = np.empty(9 + 2 * q), np.empty(size), np.empty(size), np.empty(size)
    change, along, nowhere = np.empty(size), np.empty(size), np.empty((0, 7))
    unknowns, trial, inverse = guess.copy(), guess.copy(), chord.copy()
    integrate(layout, rough, alpha, beta, force, contact, unknowns, step, slid, old, new, y, ends, bases, nowhere)
    residual = largest(ends)
    exact, stale = False, not inverse.any()  # whether the derivative was computed at this point; must be recomputed
    iterations = 0
    while residual > tolerance and iterations < 80:
        if stale:
            matrix = np.empty((size, size))
            for k in range(size):
                copy(unknowns, trial)
                # The difference is so small that friction does not change its direction within it.
                trial[k] += 1e-8
                integrate(
                    layout, rough, alpha, beta, force, contact, trial, step, slid, old, new, y, moved, bases, nowhere
                )
                for i in range(size):
                    matrix[i, k] = (moved[i] - ends[i]) / 1e-8
            if not 1e-30 <= abs(np.linalg.det(matrix)) < np.inf:
                residual = np.inf
                break
            renewed = np.linalg.inv(matrix)
            for k in range(size):
                copy(renewed[k], inverse[k])
            exact, stale = True, False
        times(inverse, ends, correction)
        fraction = 1.0
        while True:
            for i in range(size):
                trial[i] = unknowns[i] - fraction * correction[i]
            integrate(layout, rough, alpha, beta, force, contact, trial, step, slid, old, new, y, moved, bases, nowhere)
            iterations += 1
            new_residual = largest(moved)
            if new_residual < residual or not exact or fraction < 0.02:
                break
            fraction *= 0.5
        if not new_residual < residual and not exact:
            stale = True
            continue
        if not new_residual < np.inf:
            residual = np.inf
            break
        # Broyden: H += (s - H y) (s^T H) / (s^T H y)
        for i in range(size):
            along[i] = moved[i] - ends[i]
        times(inverse, along, change)
        product = 0.0
        for i in range(size):
            product -= fraction * correction[i] * change[i]
        if abs(product) > 1e-300:
            for k in range(size):
                along[k] = 0.0
                for i in range(size):
                    along[k] -= fraction * correction[i] * inverse[i, k]
            for i in range(size):
                scale = (-fraction * correction[i] - change[i]) / product
                for k in range(size):
                    inverse[i, k] += scale * along[k]
        stale = new_residual > 0.3 * residual
        exact = False
        # A short step with an exact derivative is accepted even if the residual grows, because the derivative changes
        # where friction reverses.
        copy(trial, unknowns)
        copy(moved, ends)
        residual = new_residual
    times(inverse, ends, correction)
    for i in range(size):
        unknowns[i] -= correction[i]
    tip, rotation = to_world(layout, y)
    return unknowns, inverse, tip, rotation, residual
