"""Legend of the scene: meaning and colour of its marks."""

from typing import Literal

from core.robot.robot import Robot
from station.config import palette
from station.config.strict import Strict
from web.scene.overlays import UNCERTAINTY_SCALE, UNCERTAINTY_SIGMAS
from web.scene.pointing_mark import ARROW_LENGTH_M


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
    """[m]"""


class Legend(Strict):
    """The complete legend."""

    signs: tuple[LegendEntry, ...]
    tubes: tuple[TubeLegendEntry, ...]
    """innermost first"""
    views: tuple[str, ...]
    """names of the camera's views"""


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
