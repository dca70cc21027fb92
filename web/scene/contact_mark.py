"""A contact on the shaft in the scene: a marker, the stretch in which it lies with 95 % confidence, and words."""

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
#: The words stand lower than the place, beside the shaft (3,) [m].
BELOW = np.array((0.012, 0.0, 0.0))


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
        self._label = scene.add_label("/contact/label", "", anchor="top-center", visible=False)

    def hide(self) -> None:
        """There is none."""
        self._marker.visible = self._stretch.visible = self._label.visible = False

    def draw(self, side_load: SideLoad, shape: Array) -> Array:
        """Show it on a shaft with the sections `shape` of the model; where the force most likely acts (3,) [m]."""
        place = centre_line(shape, np.array([side_load.contact.place]))[0][0]
        size = f"{float(np.linalg.norm(side_load.force)):.2f} N"
        known = side_load.contact.located
        stretches = [_segments(shape, first, last) for first, last in side_load.contact.intervals]
        self._stretch.points = np.concatenate(stretches).astype(np.float32)
        self._marker.position = self._unit * place
        self._label.position = self._unit * (place + BELOW)
        self._label.text = f"{size} at {side_load.place}" if known else f"{size}, place not known"
        self._marker.visible = known
        self._stretch.visible = self._label.visible = True
        return place


def _segments(shape: Array, first: float, last: float) -> Array:
    """Of the centre line between two arc lengths [m]: (k, 2, 3)."""
    line = centre_line(shape, np.linspace(first, last, POINTS))[0]
    return np.stack((line[:-1], line[1:]), axis=1)
