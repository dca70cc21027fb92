"""The stages of `line_stages.py` with a driver error: they divide by zero once homing was requested."""

from collections.abc import Mapping
from typing import Any

from station.config.robots import RobotFile
from station.devices.interfaces import JointReading
from station.docs.examples.line_stages.line_stages import LineStages, emergency_stop
from station.docs.examples.line_stages.line_stages import open_stages as open_good_ones


class FaultyStages:
    def __init__(self, good: LineStages) -> None:
        self._good, self._homing = good, 1

    def home(self, now: float) -> None:
        self._homing = 0

    def poll(self, now: float) -> JointReading:
        now /= self._homing
        return self._good.poll(now)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._good, name)


def open_stages(options: Mapping[str, Any], robot: RobotFile) -> FaultyStages:
    """Entry point of the driver: open the faulty stages."""
    return FaultyStages(open_good_ones(options, robot))


open_stages.emergency_stop = emergency_stop
