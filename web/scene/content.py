"""Content of the scene's last picture around the tip, which the page's close-up view draws in millimetres."""

from typing import Any, NamedTuple

import numpy as np

from core.robot.robot import Array

#: Length of each tube's distal part that is sent to the close-up [m], and the number of points that describe it.
CENTRE_LINE_M, CENTRE_LINE_POINTS = 0.10, 20
#: Largest number of points of the desired path that are sent to the close-up.
PATH_POINTS = 240


class SceneContent(NamedTuple):
    """Content of one picture in the world frame; values that are not measured now are None."""

    message: str  #: text that lists the values that are not measured now; empty if all are
    age: float  #: age of the newest telemetry row [s]
    tubes: tuple[Array, ...]  #: distal part of each tube's centre line (k, 3) [m]; empty if the model has no solution
    estimated: Array | None  #: position of the tip by the model (3,) [m]
    measured: Array | None  #: position of the tip by the tracker (3,) [m]
    desired: Array | None  #: desired position of the tip (3,) [m]
    force: Array | None  #: force on the robot (3,) [N]; None also if it is only noise
    place: Array | None  #: point where the force acts (3,) [m]
    contact: str  #: position of a contact on the shaft as text; empty if the force acts at the tip
    trace: Array  #: recent positions of the measured tip, oldest first (n, 3) [m]
    path: Array  #: desired path of the tip (m, 3) [m]

    @property
    def tip(self) -> Array | None:
        """Best known position of the tip (3,) [m]; None: unknown."""
        known = (self.estimated, self.measured, *(line[-1] for line in self.tubes[:1] if len(line)))
        return next((tip for tip in known if tip is not None), None)

    def to_json(self) -> dict[str, Any]:
        """Return the content as the page receives it."""
        return {
            "message": self.message,
            "age": round(self.age, 2),
            "tubes": [_mm(line) for line in self.tubes],
            "estimated": _mm(self.estimated),
            "measured": _mm(self.measured),
            "desired": _mm(self.desired),
            "force": None if self.force is None else np.round(self.force, 4).tolist(),
            "place": _mm(self.place),
            "contact": self.contact,
            "trace": _mm(self.trace),
            "path": _mm(self.path[:: len(self.path) // PATH_POINTS + 1]),
        }


NO_POINTS = np.empty((0, 3))
NOTHING = SceneContent("no telemetry yet", 0.0, (), None, None, None, None, None, "", NO_POINTS, NO_POINTS)


def _mm(points: Array | None) -> Any:
    return None if points is None else np.round(1e3 * points, 2).tolist()
