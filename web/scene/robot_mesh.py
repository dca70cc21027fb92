"""Meshes of the robot: the tubes around the drawn centre line, and the stages.

A tube is drawn over its whole length, from its proximal end behind the plate to its distal end. Behind the plate the
guide keeps the tubes straight. A wider tube hides the narrower one inside it.
"""

from typing import NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from viser.transforms import SO3

from core.robot.robot import Array, Robot, Tube
from station.config import palette

RINGS = 60
SIDES = 12


def centre_line(shape: Array, at: Array) -> tuple[Array, Array]:
    """Return points of the robot's centre line at arc lengths that may be negative, that is behind the plate.

    The line is cubic between cross-sections, with the model's tangents, and straight along z behind the plate.

    Args:
        shape: rows of `Statics.shape`: arc length [m], frame by rows (9), position (3) [m], ...
        at: arc lengths from the plate (k,) [m]; negative behind the plate.

    Returns:
        Positions (k, 3) [m] and right-handed frames (k, 3, 3) whose last column is the tangent.
    """
    # The model has two rows with the same arc length at the ends of tubes and sections; one of the two is dropped.
    rows = shape[np.append(True, np.diff(shape[:, 0]) > 1e-9)]
    if len(rows) == 1:  # all tubes are flush with the plate: the line has no length, but a direction
        rows = np.vstack((rows, rows))
        rows[1, 0] += 1e-3
        rows[1, 10:13] += 1e-3 * rows[0, [3, 6, 9]]
    arc, frames, points = rows[:, 0], rows[:, 1:10].reshape(-1, 3, 3), rows[:, 10:13]
    at = np.minimum(at, arc[-1])
    before = np.clip(np.searchsorted(arc, at, side="right") - 1, 0, len(arc) - 2)
    after = before + 1
    step = (arc[after] - arc[before])[:, None]
    u = np.clip((at - arc[before])[:, None] / step, 0.0, 1.0)
    p, q = points[before], points[after]
    v, w = step * frames[before, :, 2], step * frames[after, :, 2]
    position = (1 + 2 * u) * (1 - u) ** 2 * p + u * (1 - u) ** 2 * v + u**2 * (3 - 2 * u) * q + u**2 * (u - 1) * w
    tangent = 6 * u * (1 - u) * (q - p) + (1 - u) * (1 - 3 * u) * v + u * (3 * u - 2) * w
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    behind = np.minimum(at - arc[0], 0.0)[:, None]
    position = position + behind * tangent
    x = (1 - u) * frames[before, :, 0] + u * frames[after, :, 0]
    x -= tangent * np.sum(x * tangent, axis=1, keepdims=True)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return position, np.stack((x, np.cross(tangent, x), tangent), axis=2)


class Bend(NamedTuple):
    """Change of the drawn shape, so that the tubes end at the measured tip; the control loop does not use it.

    The displacement grows with the square of the arc length, as that of a cantilever does near its clamp. It does not
    change the position and the tangent at the plate.
    """

    offset: Array  #: displacement of the tip (3,) [m]
    length: float  #: arc length of the tip from the plate [m]

    def at(self, arc: Array) -> Array:
        """Return the displacements (k, 3) [m] at arc lengths (k,) [m]."""
        return np.clip(arc / self.length, 0.0, 1.0)[:, None] ** 2 * self.offset


class TubeLine(NamedTuple):
    """Drawn centre line of one tube, from its proximal end to its distal end."""

    arc: Array  #: arc lengths from the plate (k,) [m]; negative behind the plate
    position: Array  #: positions (k, 3) [m]
    frame: Array  #: frames (k, 3, 3) whose last column is the model's tangent

    def beyond(self, arc: float) -> Array:
        """Return the positions (n, 3) [m] from an arc length [m] to the distal end."""
        return self.position[self.arc >= arc]


class TubeMesh:
    """Surface mesh of one tube: vertices that follow its shape, and triangles that do not depend on it."""

    def __init__(self, tube: Tube, rings: int = RINGS, sides: int = SIDES) -> None:
        self._tube = tube
        self._rings = rings
        angles = 2.0 * np.pi * np.arange(sides) / sides
        self._circle = 0.5 * tube.outer_diameter * np.stack((np.cos(angles), np.sin(angles)), axis=1)
        self.count = (rings + 2) * sides + 2  #: number of vertices
        self.faces = _faces(rings, sides)  #: vertex indices (f, 3), anticlockwise from outside

    def line(self, shape: Array, beta: float, bend: Bend | None = None) -> TubeLine:
        """Return the drawn centre line for a `shape` of the model and a proximal end at `beta` [m].

        A bend moves the positions and keeps the frames, because it turns them by a degree or two only.
        """
        arc = np.linspace(beta, beta + self._tube.length, self._rings)
        position, frame = centre_line(shape, arc)
        return TubeLine(arc, position if bend is None else position + bend.at(arc), frame)

    def vertices(self, line: TubeLine, magnification: float = 1.0) -> Array:
        """Return the vertices (v, 3) [m] of the tube around a centre line, with its diameter magnified.

        The vertices of the rings come first, from the proximal end, then rim and centre of each end. The rims are
        repeated so that the ends are shaded flat.
        """
        across = magnification * np.einsum("kij,aj->kai", line.frame[:, :, :2], self._circle)
        rings = line.position[:, None, :] + across
        ends = rings[0], line.position[:1], rings[-1], line.position[-1:]
        return np.concatenate((rings.reshape(-1, 3), *ends))


def _faces(rings: int, sides: int) -> NDArray[np.int64]:
    j = np.arange(sides)
    next_j = (j + 1) % sides
    bands = np.arange(rings - 1)[:, None] * sides
    low, low_next, high, high_next = bands + j, bands + next_j, bands + sides + j, bands + sides + next_j
    walls = np.stack((low, low_next, high_next, low, high_next, high), axis=2).reshape(-1, 3)
    first = rings * sides
    last = first + sides + 1
    back = np.stack((first + next_j, first + j, np.full(sides, first + sides)), axis=1)
    front = np.stack((last + j, last + next_j, np.full(sides, last + sides)), axis=1)
    return np.concatenate((walls, back, front))


Point = tuple[float, float, float]

METAL_COLOUR: palette.Colour = (206, 211, 217)
DARK_COLOUR: palette.Colour = (120, 128, 138)
#: Length of the rail behind the rearmost position of a carriage [m].
RAIL_OVERHANG_M = 0.02


class StageMesh:
    """Scene objects of plate, guide, rail, and one carriage for each sliding tube, in the plate's frame."""

    def __init__(self, scene: viser.SceneApi, robot: Robot, rear: float, unit: float) -> None:
        """`rear`: rearmost position of any tube's proximal end along the plate's z axis [m], never positive."""
        self._unit = unit
        base = robot.base
        scene.add_frame(
            "/bench", show_axes=False, wxyz=SO3.from_matrix(base.rotation).wxyz, position=unit * np.array(base.position)
        )

        def box(name: str, low: Point, high: Point, colour: palette.Colour) -> None:
            a, b = unit * np.array(low), unit * np.array(high)
            scene.add_box(f"/bench/{name}", color=colour, dimensions=tuple(b - a), position=tuple((a + b) / 2))

        box("plate", (-0.022, -0.022, -0.004), (0.026, 0.022, 0.0), METAL_COLOUR)
        box("guide", (-0.008, -0.008, -0.030), (0.008, 0.008, -0.004), DARK_COLOUR)
        box("rail", (0.018, -0.010, rear - RAIL_OVERHANG_M), (0.026, 0.010, -0.004), METAL_COLOUR)
        sliding = {joint.tube for joint in robot.joints if joint.motion == "translation"}
        self._carriages = {
            tube: scene.add_box(
                f"/bench/carriage_{robot.tubes[tube].name}", color=DARK_COLOUR,
                dimensions=tuple(unit * np.array((0.026, 0.018, 0.012))),
                position=tuple(unit * np.array((0.005, 0.0, rear))),
            )
            for tube in sorted(sliding)
        }  # fmt: skip

    def move(self, beta: Array) -> None:
        """Move the carriages to the tubes' proximal ends `beta` (q,) [m]."""
        for tube, carriage in self._carriages.items():
            carriage.position = self._unit * np.array((0.005, 0.0, beta[tube]))
