"""What the marks in the scene mean, as the page's legend shows it."""

from typing import Literal

from core.robot.robot import Robot
from station.config import palette
from station.config.strict import Strict
from web.scene.overlays import LARGER, SIGMAS
from web.scene.pointing_mark import LENGTH


class Sign(Strict):
    """A mark and its meaning."""

    name: str
    colour: str
    """as CSS writes it"""
    shape: Literal["disc", "halo", "square", "bar", "line"]


class TubeSign(Strict):
    """A tube as it is drawn."""

    name: str
    colour: str
    """as CSS writes it"""
    diameter: float
    """[m]"""


class Legend(Strict):
    """Everything that is drawn."""

    signs: tuple[Sign, ...]
    tubes: tuple[TubeSign, ...]
    """innermost first"""
    views: tuple[str, ...]
    """places for the camera"""


def signs(*, target: bool) -> tuple[Sign, ...]:
    """Of what is no tube; `target`: there is one that moves."""
    css = palette.css
    moving = (
        Sign(name="target that moves", colour=css(palette.TARGET), shape="disc"),
        Sign(name="offset of the tip from the target", colour=css(palette.STEEL), shape="line"),
    )
    return (
        Sign(name="desired tip", colour=css(palette.DESIRED), shape="halo"),
        Sign(name="measured tip, trace of 20 s", colour=css(palette.MEASURED), shape="disc"),
        Sign(name="estimated tip (loaded model)", colour=css(palette.ESTIMATED), shape="square"),
        Sign(name="force, 100 mm for 1 N", colour=css(palette.FORCE), shape="bar"),
        Sign(name=f"where the tip points, {1e3 * LENGTH:.0f} mm", colour=css(palette.ESTIMATED), shape="line"),
        Sign(name="contact on the shaft, 95 %", colour=css(palette.CONTACT), shape="bar"),
        Sign(name="reference path", colour=css(palette.DESIRED), shape="line"),
        Sign(name="shape without load (on demand)", colour=css(palette.SLATE), shape="line"),
        Sign(name="workspace without load (on demand)", colour=css(palette.SKY), shape="halo"),
        Sign(name=f"uncertainty, {SIGMAS:g} sigma, {LARGER:g} times", colour=css(palette.ESTIMATED), shape="halo"),
        *(moving if target else ()),
    )


def tube_signs(robot: Robot) -> tuple[TubeSign, ...]:
    """Of the tubes, innermost first."""
    return tuple(
        TubeSign(name=f"tube '{tube.name}'", colour=palette.css(palette.tube(number)), diameter=tube.outer_diameter)
        for number, tube in enumerate(robot.tubes)
    )
