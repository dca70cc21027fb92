"""The stages of `line_stages.py` with a failing emergency stop; the option `manner` or its file sets the failure.

After a request to home, `poll` divides by zero.

The author of a driver may write any of these errors: an emergency stop that waits forever, returns nothing, ends the
interpreter, or wrongly reports success.
"""

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from station.config.robots import RobotFile
from station.devices.interfaces import Clock, JointReading, NotStopped
from station.docs.examples.line_stages.line_stages import LineStages
from station.docs.examples.line_stages.line_stages import emergency_stop as good_stop
from station.docs.examples.line_stages.line_stages import open_stages as open_good_ones


class Unprintable(Exception):
    def __str__(self) -> str:
        raise RuntimeError("not even that")


#: Event that lets a hanging emergency stop return.
RELEASED = threading.Event()
RAISED: dict[str, BaseException] = {
    "raises": RuntimeError("no such port"),
    "raises SystemExit": SystemExit(0),
    "raises KeyboardInterrupt": KeyboardInterrupt(),
    "raises the unprintable": Unprintable(),
    "raises NotStopped without a text": NotStopped(""),
}
RETURNED: dict[str, Any] = {
    "returns None": None,
    "returns an empty text": " ",
    "returns True": True,
    "returns bytes": b"stopped",
    "lies": "all stages have stopped",
}
MANNERS = ("hangs", *RAISED, *RETURNED)


class BadStages:
    def __init__(self, good: LineStages) -> None:
        self._good, self._homing = good, 1

    def home(self, now: float) -> None:
        self._homing = 0

    def poll(self, now: float) -> JointReading:
        now /= self._homing
        return self._good.poll(now)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._good, name)


def _without_manner(options: Mapping[str, Any]) -> Mapping[str, Any]:
    return {key: value for key, value in options.items() if key != "manner"}


def open_stages(options: Mapping[str, Any], robot: RobotFile) -> BadStages:
    """Entry point of the driver: open the stages."""
    return BadStages(open_good_ones(_without_manner(options), robot))


def emergency_stop(options: Mapping[str, Any], robot: RobotFile, clock: Clock) -> Any:
    """Fail in the manner that the options specify, or stop the stages if it is `works`."""
    manner = str(options["manner"])
    if manner not in MANNERS:
        manner = Path(manner).read_text(encoding="utf-8")
    if manner == "works":
        return good_stop(_without_manner(options), robot, clock)
    if manner == "hangs":
        RELEASED.wait()
        return "all stages have stopped at last"
    if manner in RAISED:
        raise RAISED[manner]
    return RETURNED[manner]


open_stages.emergency_stop = emergency_stop
