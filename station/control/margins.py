"""Safety margins against a snap: elastic stability, and the difference of tracker and model.

A tube that snaps jumps by centimetres, independent of the motors. The loaded model predicts most snaps: its stability
falls to zero. Other snaps appear as a sudden difference between the measured tip and the model's tip.
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
from station.devices.interfaces import DeviceFault, Severity

#: Number of consecutive tracker frames that must show the jump of a snap; one frame may be an outlier.
CONFIRMING_FRAMES = 3
#: Time constant [s] of the reference difference between tracker and model, which follows slow changes. A snap takes
#: milliseconds. Sensor drift of 5 mN a minute moves the model's tip by only 0.3 mm in this time.
FORGETS_S = 60.0


class Margins(Strict):
    """Margins against a snap of the tubes."""

    stability: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.1
    """stability of the loaded shape below which a motion ends in HOLD; 1: straight tubes without load, 0: snap"""
    apart: Positive = 0.030
    """change of the tip's difference between tracker and model within a minute; a larger change stops every axis [m]"""
    design: Literal["warn", "refuse"] = "warn"
    """reaction to a robot whose tubes snap somewhere within their travel without load: show a warning, or refuse it"""


class SnapMonitor:
    """Monitor that checks every tick of one motion for a snap."""

    def __init__(self, margins: Margins) -> None:
        self._margins = margins
        self._reference: Array | None = None  # recent difference of tracker and model (3,) [m]
        self._count = 0
        self._frame_at = 0.0

    def check(self, tick: Tick, frame: bool, now: float) -> DeviceFault | None:
        """Return the fault after a snap at `now` [s], or None; `frame`: whether the tick has a new tracker frame."""
        loaded = tick.memory.estimate.loaded
        if loaded.stability < self._margins.stability:
            return DeviceFault(
                Severity.HOLD,
                f"the tubes are about to snap: stability {loaded.stability:.2g} is below {self._margins.stability:g};"
                " take the load off, or jog the joints back",
            )
        if not frame:
            return None
        away = tick.memory.tip - loaded.tip
        if self._reference is None:
            self._reference, self._frame_at = away, now
        # Drift of the sensors separates tracker and model by millimetres in minutes without a snap.
        part = min((now - self._frame_at) / FORGETS_S, 1.0)
        self._frame_at = now
        change = away - self._reference
        apart = float(np.linalg.norm(change))
        if apart <= self._margins.apart:
            self._reference = self._reference + part * change
        self._count = self._count + 1 if apart > self._margins.apart else 0
        if self._count < CONFIRMING_FRAMES:
            return None
        return DeviceFault(
            Severity.STOP,
            f"the difference of tracker and model has changed by {1e3 * apart:.0f} mm within a minute, more than"
            f" {1e3 * self._margins.apart:g} mm: the tubes may have snapped or touched something, or the field"
            " generator was moved; check before you reset",
        )


def check_design(robot: RobotFile, margins: Margins) -> str:
    """Return a warning if the tubes of a robot snap without load, or if that is unknown; otherwise an empty text.

    Raises:
        ConfigError: the tubes snap, and `margins.design` is "refuse".
    """
    lower, upper = (np.array([getattr(joint, end) for joint in robot.joints]) for end in ("lower", "upper"))
    try:
        number = design_snap_number(robot.robot(), lower, upper)
    except DescriptionError as error:
        return f"{error}, so it cannot be determined in advance whether its tubes snap: watch its stability"
    if number < 1.0:
        return ""
    text = (
        f"robot '{robot.name}': its tubes snap somewhere within their travel (snap number {number:.2f} is not below 1):"
        " choose shorter or straighter tubes, less travel behind the plate, or watch its stability"
    )
    if margins.design == "refuse":
        raise ConfigError(f"{text}; margins.design = 'warn' accepts it")
    return text
