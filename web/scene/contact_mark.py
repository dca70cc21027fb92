"""Marker of a contact in the scene, and the section of the shaft that contains it with 95 % confidence."""

import numpy as np
import viser

from core.robot.robot import Array
from station.config import palette
from web.scene.contact import SideLoad
from web.scene.tubes import centre_line

#: Number of points of the line that marks each section of the shaft.
MARK_POINTS = 24
#: Diameter of the line that marks the 95 % section of the shaft, and radius of the sphere at the contact's most likely
#: position [m]. Both are thicker than the tubes, so that the tubes do not hide them.
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

    def draw(self, side_load: SideLoad, shape: Array) -> Array:
        """Show a contact on the shaft, given the model's `shape`; return its most likely position (3,) [m]."""
        position = centre_line(shape, np.array([side_load.contact.arc_length]))[0][0]
        sections = [_segments(shape, first, last) for first, last in side_load.contact.intervals]
        self._section.points = np.concatenate(sections).astype(np.float32)
        self._marker.position = self._unit * position
        self._marker.visible = side_load.contact.located
        self._section.visible = True
        return position


def _segments(shape: Array, first: float, last: float) -> Array:
    """Return the segments (k, 2, 3) [m] of the centre line between two arc lengths [m]."""
    line = centre_line(shape, np.linspace(first, last, MARK_POINTS))[0]
    return np.stack((line[:-1], line[1:]), axis=1)
