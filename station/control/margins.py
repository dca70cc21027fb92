"""How near to a snap a motion may come: elastic stability, and how far model and tracker drift apart.

A tube that snaps jumps by centimetres, whatever the motors do. The loaded model sees most snaps come, as
its stability falls to zero; what it does not see shows as a tip that is suddenly elsewhere than the model has it.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from core.control.step import Tick
from core.errors import DescriptionError
from core.robot.robot import Array
from core.robot.stability import design_snap_number
from station.config.robots import RobotFile
from station.config.strict import ConfigError, Positive, Strict
from station.devices.interfaces import Severity, Trouble

#: Tracker frames one after the other that have to agree on it: one alone may be an outlier.
FRAMES = 3


class Margins(Strict):
    """What is left before the tubes snap."""

    stability: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.1
    """of the loaded shape, below which a motion is held; straight tubes without load have 1, a snap is at 0"""
    apart: Positive = 0.030
    """tracker and model, beyond what they were at the motion's start: everything is stopped [m]"""
    design: Literal["warn", "refuse"] = "warn"
    """a robot whose tubes snap somewhere within their travel without load"""


class SnapMonitor:
    """Looks at every tick of one motion."""

    def __init__(self, margins: Margins) -> None:
        self._margins = margins
        self._first: Array | None = None  # tracker less model at the motion's start (3,) [m]
        self._count = 0

    def look(self, tick: Tick, frame: bool) -> Trouble | None:
        """What is wrong; `frame`: the tick has a new tracker frame."""
        loaded = tick.memory.estimate.loaded
        if loaded.stability < self._margins.stability:
            return Trouble(
                Severity.HOLD,
                f"the tubes are about to snap: stability {loaded.stability:.2g} is below {self._margins.stability:g};"
                " take the load off, or lead the joints back by hand",
            )
        if not frame:
            return None
        away = tick.memory.tip - loaded.tip
        if self._first is None:
            self._first = away
        apart = float(np.linalg.norm(away - self._first))
        self._count = self._count + 1 if apart > self._margins.apart else 0
        if self._count < FRAMES:
            return None
        return Trouble(
            Severity.STOP,
            f"model and tracker are {1e3 * apart:.0f} mm further apart than at the motion's start, more than"
            f" {1e3 * self._margins.apart:g} mm: have the tubes snapped or touched something, has the field generator"
            " been moved? look before you reset",
        )


def check_design(robot: RobotFile, margins: Margins) -> str:
    """What is to be said of a robot whose tubes snap without load, or may; empty when they do not.

    Raises:
        ConfigError: they do, and such designs are to be refused.
    """
    lower, upper = (np.array([getattr(joint, end) for joint in robot.joints]) for end in ("lower", "upper"))
    try:
        number = design_snap_number(robot.robot(), lower, upper)
    except DescriptionError as error:
        return f"{error}, so nobody can say beforehand whether its tubes snap: watch its stability"
    if number < 1.0:
        return ""
    text = (
        f"robot '{robot.name}': its tubes snap somewhere within their travel (snap number {number:.2f} is not below 1):"
        " choose shorter or straighter tubes, less travel behind the plate, or watch its stability"
    )
    if margins.design == "refuse":
        raise ConfigError(f"{text}; margins.design = 'warn' takes it all the same")
    return text
