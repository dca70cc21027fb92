"""A contact on the shaft in the scene: a marker, and the stretch in which it lies with 95 % confidence."""

import numpy as np
import viser

from core.robot.robot import Array
from station.config import palette
from web.scene.contact import SideLoad
from web.scene.tubes import centre_line

#: Points along the stretches.
POINTS = 24
#: Around the shaft, so that it is seen beside the tubes [m].
THICKNESS, MARKER = 4.4e-3, 3.2e-3


class ContactMark:
    """Handles of what shows a contact."""

    def __init__(self, scene: viser.SceneApi, unit: float) -> None:
        self._unit = unit
        self._marker = scene.add_icosphere(
            "/contact/place", radius=MARKER * unit, color=palette.CONTACT, cast_shadow=False, visible=False
        )
        self._stretch = scene.add_line_segments(
            "/contact/stretch", np.zeros((1, 2, 3)), palette.CONTACT, thickness=THICKNESS * unit, scale=unit,
            visible=False,
        )  # fmt: skip

    def hide(self) -> None:
        """There is none."""
        self._marker.visible = self._stretch.visible = False

    def draw(self, side_load: SideLoad, shape: Array) -> Array:
        """Show it on a shaft with the sections `shape` of the model; where the force most likely acts (3,) [m]."""
        place = centre_line(shape, np.array([side_load.contact.place]))[0][0]
        stretches = [_segments(shape, first, last) for first, last in side_load.contact.intervals]
        self._stretch.points = np.concatenate(stretches).astype(np.float32)
        self._marker.position = self._unit * place
        self._marker.visible = side_load.contact.located
        self._stretch.visible = True
        return place


def _segments(shape: Array, first: float, last: float) -> Array:
    """Of the centre line between two arc lengths [m]: (k, 2, 3)."""
    line = centre_line(shape, np.linspace(first, last, POINTS))[0]
    return np.stack((line[:-1], line[1:]), axis=1)
