"""What the last picture shows around the tip, for the page's own close-up: millimetres, world frame."""

from typing import Any, NamedTuple

import numpy as np

from core.robot.robot import Array

#: Of a tube's centre line the last so much is told [m], in so many points.
LINE, POINTS = 0.10, 20
#: Points of the reference path that are told.
PATH_POINTS = 240


class Drawn(NamedTuple):
    """One picture; what is not measured now is None."""

    says: str  #: what is wrong with it, for a person
    age: float  #: of the newest row [s]
    tubes: tuple[Array, ...]  #: end of each centre line (k, 3) [m]; empty where there is no shape
    estimated: Array | None  #: (3,) [m]
    measured: Array | None  #: (3,) [m]
    desired: Array | None  #: (3,) [m]
    force: Array | None  #: (3,) [N]; None as well when it is no more than noise
    place: Array | None  #: where it acts (3,) [m]
    contact: str  #: where that is on the shaft, for a person; empty at the tip
    trace: Array  #: of the measured tip, oldest first (n, 3) [m]
    path: Array  #: that the tip is asked to follow (m, 3) [m]

    @property
    def tip(self) -> Array | None:
        """Where it is (3,) [m], as far as that is known."""
        known = (self.estimated, self.measured, *(line[-1] for line in self.tubes[:1] if len(line)))
        return next((place for place in known if place is not None), None)

    def told(self) -> dict[str, Any]:
        """As the page gets it."""
        return {
            "says": self.says,
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


NONE = np.empty((0, 3))
NOTHING = Drawn("no telemetry yet", 0.0, (), None, None, None, None, None, "", NONE, NONE)


def _mm(places: Array | None) -> Any:
    return None if places is None else np.round(1e3 * places, 2).tolist()
