"""Marks of the scene with their legend: contact on the shaft, direction of the tip, and moving target."""

from typing import Literal

import numpy as np
import viser

from core.robot.robot import Array, Robot
from station.config import palette
from station.config.strict import Strict
from station.service.contact import SideLoad
from web.scene.grid import COARSE_SPACING_M, FINE_SPACING_M
from web.scene.overlays import UNCERTAINTY_SCALE, UNCERTAINTY_SIGMAS
from web.scene.robot_mesh import Bend, centre_line

#: Factor on the drawn diameter of the tubes: at their true diameter they are two pixels wide in most views.
TUBE_MAGNIFICATION = 2.0

#: Number of points of the line that marks each section of the shaft.
MARK_POINTS = 24
#: Diameter of the line along the 95 % section of the shaft, and radius of the sphere at the most likely contact [m],
#: for tubes at their true diameter. Both are thicker than the tubes, so that the tubes do not hide them.
THICKNESS_M, MARKER_M = 4.4e-3, 3.2e-3


class ContactMark:
    """Scene objects that show a contact on the shaft."""

    def __init__(self, scene: viser.SceneApi, unit: float) -> None:
        self._unit = unit
        self._marker = scene.add_icosphere(
            "/contact/place", radius=MARKER_M * unit, color=palette.CONTACT, cast_shadow=False, visible=False
        )
        self._section = scene.add_line_segments(
            "/contact/stretch", np.zeros((1, 2, 3)), palette.CONTACT, thickness=THICKNESS_M * unit, scale=unit,
            visible=False,
        )  # fmt: skip

    def hide(self) -> None:
        """Hide the marker and its section."""
        self._marker.visible = self._section.visible = False

    def draw(self, side_load: SideLoad, shape: Array, bend: Bend, magnification: float) -> Array:
        """Show a contact on the drawn shaft; return its most likely position (3,) [m]."""
        position = _points(shape, bend, np.array([side_load.contact.arc_length]))[0]
        sections = [_segments(shape, bend, first, last) for first, last in side_load.contact.intervals]
        self._section.thickness = THICKNESS_M * self._unit * magnification
        self._marker.radius = MARKER_M * self._unit * magnification
        self._section.points = np.concatenate(sections).astype(np.float32)
        self._marker.position = self._unit * position
        self._marker.visible = side_load.contact.located
        self._section.visible = True
        return position


def _points(shape: Array, bend: Bend, arc: Array) -> Array:
    return centre_line(shape, arc)[0] + bend.at(arc)


def _segments(shape: Array, bend: Bend, first: float, last: float) -> Array:
    """Return the segments (k, 2, 3) [m] of the drawn centre line between two arc lengths [m]."""
    line = _points(shape, bend, np.linspace(first, last, MARK_POINTS))
    return np.stack((line[:-1], line[1:]), axis=1)


#: Length of each direction arrow [m].
ARROW_LENGTH_M = 0.030


class PointingMark:
    """Scene objects that show the measured and the desired direction of the tip."""

    def __init__(self, scene: viser.SceneApi, unit: float) -> None:
        def arrow(name: str, colour: palette.Colour, thickness: float) -> viser.ArrowsHandle:
            return scene.add_arrows(
                f"/pointing/{name}", np.zeros((1, 2, 3)), colour, shaft_radius=thickness, head_radius=2.5 * thickness,
                head_length=0.008, scale=unit, visible=False,
            )  # fmt: skip

        # The arrow of the desired direction is wider, so that it stays visible where it coincides with the other arrow.
        self._desired = arrow("desired", palette.DESIRED, 1.1e-3)
        self._observed = arrow("observed", palette.ESTIMATED, 0.7e-3)

    def draw(self, tip: Array | None, observed: Array | None, desired: Array | None) -> None:
        """Draw arrows from `tip` (3,) [m] along the directions (3,); an arrow whose direction is None is hidden."""
        for arrow, direction in ((self._observed, observed), (self._desired, desired)):
            arrow.visible = tip is not None and direction is not None
            if tip is not None and direction is not None:
                arrow.points = np.array([[tip, tip + ARROW_LENGTH_M * direction]], dtype=np.float32)


#: Radius of the target's marker [m].
MARK_RADIUS_M = 3.4e-3


class TargetMark:
    """Scene objects that show a moving target and the tip's desired offset from it."""

    def __init__(self, scene: viser.SceneApi, unit: float) -> None:
        self._unit = unit
        self._marker = scene.add_icosphere(
            "/target/place", radius=MARK_RADIUS_M * unit, color=palette.TARGET, cast_shadow=False, visible=False
        )
        self._line = scene.add_line_segments(
            "/target/offset", np.zeros((1, 2, 3)), palette.STEEL, thickness=2.5, thickness_units="screen",
            scale=unit, visible=False,
        )  # fmt: skip

    def draw(self, position: Array | None, offset: Array | None) -> None:
        """Draw the target and the line to the desired tip.

        Args:
            position: position of the target (3,) [m]; None hides the target.
            offset: desired position of the tip relative to the target (3,) [m]; None hides the line.
        """
        self._marker.visible = position is not None
        self._line.visible = position is not None and offset is not None
        if position is None:
            return
        self._marker.position = self._unit * position
        if offset is not None:
            self._line.points = np.array([[position, position + offset]], dtype=np.float32)


class LegendEntry(Strict):
    """A mark and its meaning."""

    name: str
    colour: str
    """CSS colour"""
    shape: Literal["disc", "halo", "square", "bar", "line"]


class TubeLegendEntry(Strict):
    """A tube with its colour."""

    name: str
    colour: str
    """CSS colour"""
    diameter: float
    """outer diameter of the tube [m]"""


class Legend(Strict):
    """The complete legend."""

    signs: tuple[LegendEntry, ...]
    tubes: tuple[TubeLegendEntry, ...]
    """tubes, innermost first"""
    views: tuple[str, ...]
    """names of the camera's views"""
    magnification: float
    """factor on the drawn diameter of the tubes, unless they are drawn at their true diameter"""


def signs(*, target: bool) -> tuple[LegendEntry, ...]:
    """Return the legend's entries of all marks except tubes; `target`: include the marks of a moving target."""
    css = palette.css
    moving = (
        LegendEntry(name="moving target", colour=css(palette.TARGET), shape="disc"),
        LegendEntry(name="offset of the tip from the target", colour=css(palette.STEEL), shape="line"),
    )
    return (
        LegendEntry(name="desired tip", colour=css(palette.DESIRED), shape="halo"),
        LegendEntry(name="measured tip, trace of 20 s", colour=css(palette.MEASURED), shape="disc"),
        LegendEntry(name="estimated tip (loaded model)", colour=css(palette.ESTIMATED), shape="square"),
        LegendEntry(name="force, 100 mm for 1 N", colour=css(palette.FORCE), shape="bar"),
        LegendEntry(
            name=f"direction of the tip, {1e3 * ARROW_LENGTH_M:.0f} mm", colour=css(palette.ESTIMATED), shape="line"
        ),
        LegendEntry(name="contact on the shaft, 95 %", colour=css(palette.CONTACT), shape="bar"),
        LegendEntry(name="reference path", colour=css(palette.DESIRED), shape="line"),
        LegendEntry(name="end of the model, not at the measured tip", colour=css(palette.ESTIMATED), shape="line"),
        LegendEntry(
            name=f"grid, {1e3 * FINE_SPACING_M:.0f} mm and {1e3 * COARSE_SPACING_M:.0f} mm",
            colour=css(palette.GREY),
            shape="line",
        ),
        LegendEntry(name="shape without load (on demand)", colour=css(palette.SLATE), shape="line"),
        LegendEntry(name="workspace without load (on demand)", colour=css(palette.SKY), shape="halo"),
        LegendEntry(
            name=f"uncertainty, {UNCERTAINTY_SIGMAS:g} sigma, {UNCERTAINTY_SCALE:g} times",
            colour=css(palette.ESTIMATED),
            shape="halo",
        ),
        *(moving if target else ()),
    )


def tube_signs(robot: Robot) -> tuple[TubeLegendEntry, ...]:
    """Return the legend's entries of the tubes, innermost first."""
    return tuple(
        TubeLegendEntry(
            name=f"tube '{tube.name}'", colour=palette.css(palette.tube(number)), diameter=tube.outer_diameter
        )
        for number, tube in enumerate(robot.tubes)
    )
