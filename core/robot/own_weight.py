"""The tubes' own weight as an equivalent force at the tip.

At the end of a cantilever of length L, a distributed weight w(s) causes the same sag as the end force

    F = integral of w(s) s^2 (3 L - s) / (2 L^3) ds        (3/8 w L for one tube from the plate to the tip).

The formula ignores curvature, and ignores that the inner tube is softer than the bundle. The resulting error is some
percent of a sag of half a millimetre.
"""

from core.robot.robot import Array, Robot


def own_weight(robot: Robot, joints: Array) -> float:
    """Return the force at the tip [N], along gravity, equivalent to the tubes' own weight at `joints` (n,)."""
    _, beta = robot.tube_poses(joints)
    ends = [float(start) + tube.length for start, tube in zip(beta, robot.tubes, strict=True)]
    tip = ends[0]
    return sum(
        tube.weight * (tip * end**3 - 0.25 * end**4) / (2.0 * tip**3)
        for tube, end in zip(robot.tubes, ends, strict=True)
    )
