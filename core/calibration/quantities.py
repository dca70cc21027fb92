"""Calibrated parameters of a robot's tubes, and the robot with changed parameters.

The zero angle d of a tube is the direction of its curve when its stage reads zero. It is expressed as the direction of
the precurvature: (kappa cos d, kappa sin d). By convention, the zero angle of the outermost rotating tube that is
curved (`reference_tube`) is fixed. This tube defines the x axis of the robot's frame, to which the tracker's rotation
about z refers; a nearly straight tube could not define this axis. The straight length of the outermost curved tube is
fixed for a similar reason: if the straight parts of all tubes were a millimetre longer, every tip position would be a
millimetre further along z, as if the tracker had moved. A zero error of a translation has the same effect as an error
of the tube's straight length, so the fitted straight length includes it.

In the model, an outer tube ends where the inner tubes lose contact with it. With clearance, this point is some
millimetres before the outer tube's edge. The fitted length of the outer tube's last section is the effective length up
to this point, not the length measured with a ruler.

`torsional_stiffness` makes GJ independent of EI and Poisson's ratio. `curve_start` moves the border between the
straight part and the curve and keeps the tube's total length. This quantity is for tubes whose ends are flush in some
pose: the ends stay flush.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from core.calibration.fit import Parameter
from core.errors import DescriptionError
from core.robot.robot import Array, Robot, Section, Tube

Kind = Literal[
    "bending_stiffness", "curvature", "poisson_ratio", "torsional_stiffness", "straight_length", "curve_start",
    "zero_angle", "end",
]  # fmt: skip

#: Tubes whose ends come closer than this in some pose count as flush [m]: a fit of their lengths would move one end
#: past the other, which the model does not allow.
MIN_TUBE_DISTANCE_M = 1.5e-3
#: A tube counts as curved if the moment that straightens it is at least this fraction of the largest such moment.
MIN_CURVED_SHARE = 0.1
#: Unit and standard deviation of the prior for each kind of quantity. The values are for tubes made to a drawing, and
#: for zero positions of the stages that were set by hand.
QUANTITY_PRIORS: dict[Kind, tuple[str, float]] = {
    "bending_stiffness": ("", 0.10),  # fraction of the described value
    "curvature": ("", 0.10),  # fraction of the described value
    "poisson_ratio": ("", 0.05),
    "torsional_stiffness": ("", 0.25),  # fraction of the described value
    "straight_length": ("m", 0.2e-3),
    "curve_start": ("m", 1e-3),  # heat-set tubes: the curve starts within a millimetre of the drawing
    "zero_angle": ("rad", math.radians(5.0)),
    "end": ("m", 5e-3),
}


@dataclass(frozen=True)
class Quantity:
    """A calibrated parameter of one tube."""

    tube: int  #: index of the tube; 0 is the innermost
    kind: Kind

    def parameter(self, robot: Robot) -> Parameter:
        """Return the fit parameter of this quantity: its deviation from the value of `robot`."""
        tube = robot.tubes[self.tube]
        unit, expected = QUANTITY_PRIORS[self.kind]
        bounds = (-math.inf, math.inf)
        if self.kind == "poisson_ratio":
            bounds = (-0.999 - tube.poisson_ratio, 0.5 - 1e-9 - tube.poisson_ratio)
        elif self.kind == "straight_length":
            bounds = (-0.99 * tube.sections[0].length, math.inf)
        elif self.kind == "curve_start":
            bounds = (-0.99 * tube.sections[0].length, 0.99 * tube.sections[1].length)
        elif self.kind == "end":
            bounds = (-0.9 * tube.sections[-1].length, math.inf)
        elif self.kind != "zero_angle":
            bounds = (-0.9, 9.0)
        return Parameter(f"{tube.name} {self.kind}", unit, expected, expected, bounds)


def quantities(robot: Robot, joints: Sequence[Array] = ()) -> tuple[Quantity, ...]:
    """Return the tube parameters of a robot that can be calibrated at poses `joints`, each (n,).

    They are stiffness EI, curvature, Poisson's ratio, straight length, zero angle, and effective end of an outer tube.
    A tube that ends flush with a neighbour keeps its total length; only the start of its curve is calibrated.
    """
    flush = end_distances(robot, joints) < MIN_TUBE_DISTANCE_M
    reference, last = reference_tube(robot), len(robot.tubes) - 1
    last_curved = max((i for i in range(last + 1) if _pull(robot.tubes[i]) > 0.0), default=last)
    found: list[Quantity] = []
    for i, tube in enumerate(robot.tubes):
        curved = any(math.hypot(*section.curvature) > 0.0 for section in tube.sections)
        found.append(Quantity(i, "bending_stiffness"))
        if curved:
            found.append(Quantity(i, "curvature"))
        if tube.torsional_stiffness is None:
            found.append(Quantity(i, "poisson_ratio"))
        fitted = i != last and (flush[i] or i != last_curved)
        if curved and fitted and math.hypot(*tube.sections[0].curvature) == 0.0:
            found.append(Quantity(i, "curve_start" if flush[i] else "straight_length"))
        if curved and i != reference:
            found.append(Quantity(i, "zero_angle"))
        if i > 0 and not flush[i]:
            found.append(Quantity(i, "end"))
    return tuple(found)


def reference_tube(robot: Robot) -> int:
    """Return the index of the outermost rotating tube that is curved, whose zero angle defines the frame's x axis.

    A tube counts as curved if its precurvature bends the robot noticeably compared with that of the other tubes.
    """
    turned = [joint.tube for joint in robot.joints if joint.motion == "rotation"]
    pulls = [_pull(tube) for tube in robot.tubes]
    curved = [i for i in turned if pulls[i] > 0.0 and pulls[i] >= MIN_CURVED_SHARE * max(pulls)]
    return max(curved or turned, default=len(robot.tubes) - 1)


def _pull(tube: Tube) -> float:
    """Return the largest moment that straightens a tube [N m]."""
    return tube.bending_stiffness * max(math.hypot(*section.curvature) for section in tube.sections)


def end_distances(robot: Robot, joints: Sequence[Array]) -> Array:
    """Return the smallest distance (q,) of each tube's end from its neighbours' ends at poses `joints` [m].

    Two tubes without translation joints have the same distance at every pose. If `joints` is empty, all other
    distances are infinite.
    """
    slides = {joint.tube for joint in robot.joints if joint.motion == "translation"}
    moving = np.array([i in slides or i + 1 in slides for i in range(len(robot.tubes) - 1)], bool)
    poses = joints if len(joints) else [np.zeros(len(robot.joints))]
    ends = np.array([robot.tube_poses(pose)[1] for pose in poses]) + [tube.length for tube in robot.tubes]
    apart = np.abs(np.diff(ends, axis=1)).min(axis=0)
    if not len(joints):
        apart[moving] = math.inf
    return np.minimum(np.append(math.inf, apart), np.append(apart, math.inf))


def with_changes(robot: Robot, what: Sequence[Quantity], by: Array) -> Robot:
    """Return the robot with each quantity changed by its element of `by` (p,).

    Raises:
        DescriptionError: the changed robot is invalid.

    """
    tubes = list(robot.tubes)
    for quantity, amount in zip(what, by, strict=False):
        described = robot.tubes[quantity.tube]
        tubes[quantity.tube] = _changed(tubes[quantity.tube], quantity.kind, float(amount), described)
    return replace(robot, tubes=tuple(tubes))


def _changed(tube: Tube, kind: Kind, by: float, described: Tube) -> Tube:
    first = tube.sections[0]
    if kind == "bending_stiffness":
        torsion = tube.torsional_stiffness
        return replace(
            tube,
            bending_stiffness=(1.0 + by) * tube.bending_stiffness,
            torsional_stiffness=None if torsion is None else (1.0 + by) * torsion,
        )
    if kind == "curvature":
        return replace(tube, sections=tuple(_turned(section, 1.0 + by, 0.0) for section in tube.sections))
    if kind == "poisson_ratio":
        return replace(tube, poisson_ratio=tube.poisson_ratio + by)
    if kind == "torsional_stiffness":
        # The change is a fraction of the robot file's torsional stiffness GJ, independent of the fitted EI.
        torsion = described.bending_stiffness / described.stiffness_ratio
        return replace(tube, torsional_stiffness=(1.0 + by) * torsion)
    if kind == "curve_start":
        curve = tube.sections[1]
        start = (replace(first, length=first.length + by), replace(curve, length=curve.length - by))
        return replace(tube, sections=(*start, *tube.sections[2:]))
    if kind == "straight_length":
        if math.hypot(*first.curvature) > 0.0:
            raise DescriptionError(f"tube '{tube.name}' has no straight part at its proximal end")
        return replace(tube, sections=(replace(first, length=first.length + by), *tube.sections[1:]))
    if kind == "end":
        last = tube.sections[-1]
        return replace(tube, sections=(*tube.sections[:-1], replace(last, length=last.length + by)))
    return replace(tube, sections=tuple(_turned(section, 1.0, by) for section in tube.sections))


def _turned(section: Section, factor: float, angle: float) -> Section:
    x, y = section.curvature
    cos, sin = factor * math.cos(angle), factor * math.sin(angle)
    return replace(section, curvature=(cos * x - sin * y, sin * x + cos * y))
