"""Numbers of a robot that its data sheet may have wrong, and the robot with them changed.

The zero angle of a tube is the direction in which it is curved when its stage reads zero, so it is
written as the direction of the precurvature: (kappa cos d, kappa sin d). The zero of the outermost tube that turns
stays as it is, by convention: it says where x of the robot's frame points, and with it what the rotation of the
tracker's frame about z is counted from. In the same way the straight length of the outermost tube stays as it
is: were all tubes straight for a millimetre more, everything would stand a millimetre further along z, as if
the tracker had moved. A zero error of a translation shifts the curved part like the straight length does, to which
it is added.

An outer tube ends, for the shape, where the inner ones leave it: with clearance some millimetres before its edge. The
length of its last section is that, and not what a ruler says.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from core.calibration.fit import Parameter
from core.errors import DescriptionError
from core.robot.robot import Array, Robot, Section, Tube

Kind = Literal["bending_stiffness", "curvature", "poisson_ratio", "straight_length", "zero_angle", "end"]

#: Unit and what is known beforehand, one standard deviation: drawn tubes and hand-set zeros.
EXPECTED: dict[Kind, tuple[str, float]] = {
    "bending_stiffness": ("", 0.10),  # part of the described one
    "curvature": ("", 0.10),  # part of the described one
    "poisson_ratio": ("", 0.05),
    "straight_length": ("m", 0.2e-3),
    "zero_angle": ("rad", math.radians(5.0)),
    "end": ("m", 5e-3),
}


@dataclass(frozen=True)
class Quantity:
    """One number of one tube."""

    tube: int  #: 0 = innermost
    kind: Kind

    def parameter(self, robot: Robot) -> Parameter:
        """Its place in a fit, as a deviation from `robot`."""
        tube = robot.tubes[self.tube]
        unit, expected = EXPECTED[self.kind]
        bounds = (-math.inf, math.inf)
        if self.kind == "poisson_ratio":
            bounds = (-0.999 - tube.poisson_ratio, 0.5 - 1e-9 - tube.poisson_ratio)
        elif self.kind == "straight_length":
            bounds = (-0.99 * tube.sections[0].length, math.inf)
        elif self.kind == "end":
            bounds = (-0.9 * tube.sections[-1].length, math.inf)
        elif self.kind != "zero_angle":
            bounds = (-0.9, 9.0)
        return Parameter(f"{tube.name} {self.kind}", unit, expected, expected, bounds)


def quantities(robot: Robot) -> tuple[Quantity, ...]:
    """What can be wrong about a robot's tubes: EI, curvature, nu, straight length, zero angle, an outer one's end."""
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


def changed(robot: Robot, what: Sequence[Quantity], by: Array) -> Robot:
    """The robot with each quantity changed by its part of `by` (p,).

    Raises:
        DescriptionError: there can be no such robot.

    """
    tubes = list(robot.tubes)
    for quantity, amount in zip(what, by, strict=False):
        tubes[quantity.tube] = _changed(tubes[quantity.tube], quantity.kind, float(amount))
    return replace(robot, tubes=tuple(tubes))


def _changed(tube: Tube, kind: Kind, by: float) -> Tube:
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
