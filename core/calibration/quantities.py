"""Calibrated parameters of a robot's tubes, and the robot with changed parameters.

The zero angle d of a tube is the direction of its curve when its stage reads zero. It is expressed as the direction of
the precurvature: (kappa cos d, kappa sin d). By convention, the zero angle of the outermost rotating tube is fixed.
This tube defines the x axis of the robot's frame, to which the tracker's rotation about z refers. The straight length
of the outermost tube is fixed for a similar reason. If the straight parts of all tubes were a millimetre longer, every
tip position would be a millimetre further along z, as if the tracker had moved. A zero error of a translation has the
same effect as an error of the tube's straight length, so the fitted straight length includes it.

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

from core.calibration.fit import Parameter
from core.errors import DescriptionError
from core.robot.robot import Array, Robot, Section, Tube

Kind = Literal[
    "bending_stiffness", "curvature", "poisson_ratio", "torsional_stiffness", "straight_length", "curve_start",
    "zero_angle", "end",
]  # fmt: skip

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

    tube: int  #: 0 = innermost
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


def quantities(robot: Robot) -> tuple[Quantity, ...]:
    """Return the tube parameters of a robot that can be calibrated.

    They are stiffness EI, curvature, Poisson's ratio, straight length, zero angle, and effective end of an outer tube.
    """
    turned = [joint.tube for joint in robot.joints if joint.motion == "rotation"]
    last = len(robot.tubes) - 1
    reference = max(turned, default=last)
    found: list[Quantity] = []
    for i, tube in enumerate(robot.tubes):
        curved = any(math.hypot(*section.curvature) > 0.0 for section in tube.sections)
        found.append(Quantity(i, "bending_stiffness"))
        if curved:
            found.append(Quantity(i, "curvature"))
        if tube.torsional_stiffness is None:
            found.append(Quantity(i, "poisson_ratio"))
        if curved and i != last and math.hypot(*tube.sections[0].curvature) == 0.0:
            found.append(Quantity(i, "straight_length"))
        if curved and i != reference:
            found.append(Quantity(i, "zero_angle"))
        if i > 0:
            found.append(Quantity(i, "end"))
    return tuple(found)


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
