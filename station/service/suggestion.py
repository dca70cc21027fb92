"""Suggest a slower or smaller motion, checked on the model, in place of a motion that cannot be followed."""

from collections.abc import Callable

from pydantic import ValidationError

from core.control.step import Controller
from core.errors import CtrError
from core.robot.robot import Array
from station.config.motions import (
    CircleMotion,
    HelixMotion,
    Orders,
    SinusoidMotion,
    StepMotion,
    TipMotion,
    WaypointsMotion,
)  # fmt: skip
from station.config.units import format_quantity

#: Factors on the duration and on the size of a motion that are checked, the smallest change first.
SLOWER_FACTORS = (1.25, 1.5, 2.0, 3.0, 5.0)
SMALLER_FACTORS = (0.8, 0.6, 0.4, 0.2)

#: Hint that is shown if no slower or smaller motion is possible.
WORKING_POSE_HINT = "from the robot's working pose there is more room: go there first (tab Jog, or POST /api/goto)"

Change = Callable[[TipMotion, float], tuple[TipMotion, str] | None]


def suggest_motion(
    motion: TipMotion, controller: Controller, joints: Array, duration: float,
    cancelled: Callable[[], bool] = lambda: False,
) -> str:  # fmt: skip
    """Suggest a motion that is possible from `joints` (n,) [rad or m]; empty if no checked motion is possible.

    Args:
        motion: motion that cannot be followed.
        controller: controller with the model and limits for the checks.
        joints: start pose.
        duration: duration of the motion [s]; slower waypoints take longer.
        cancelled: function that returns whether the result is no longer required.

    Raises:
        Cancelled: the result is no longer required.
    """
    for change, factors in ((_slower, SLOWER_FACTORS), (_smaller, SMALLER_FACTORS)):
        for factor in factors:
            changed = change(motion, factor)
            if changed is None:
                break
            other, words = changed
            longer = duration * factor if isinstance(motion, WaypointsMotion) and change is _slower else duration
            try:
                other = type(other).model_validate(other.model_dump())
                Orders(other, controller.statics.robot).check(controller, joints, longer, cancelled=cancelled)
            except (CtrError, ValidationError):
                continue
            return f"{words} would work from here"
    return ""


def _slower(motion: TipMotion, factor: float) -> tuple[TipMotion, str] | None:
    """Return the motion slowed by `factor` and its description; None for a motion without a speed."""
    match motion:
        case CircleMotion():
            period = _round(motion.period * factor)
            return motion.model_copy(update={"period": period}), f"a period of {format_quantity(period, 's')}"
        case HelixMotion():
            turn = _round(motion.turn * factor)
            return motion.model_copy(update={"turn": turn}), f"{format_quantity(turn, 's')} for one turn"
        case SinusoidMotion():
            frequency = _round(motion.frequency / factor)
            return motion.model_copy(
                update={"frequency": frequency}
            ), f"a frequency of {format_quantity(frequency, 'Hz')}"
        case WaypointsMotion():
            points = tuple((time * factor, *position) for time, *position in motion.points)
            return motion.model_copy(update={"points": points}), f"times {factor:g} times as long"
        case _:
            return None


def _smaller(motion: TipMotion, factor: float) -> tuple[TipMotion, str] | None:
    """Return the motion scaled by `factor` and its description; None for a motion without a size."""
    match motion:
        case CircleMotion():
            radius = _round(motion.radius * factor)
            return motion.model_copy(update={"radius": radius}), f"a radius of {format_quantity(radius, 'm')}"
        case HelixMotion():
            radius, pitch = _round(motion.radius * factor), _round(motion.pitch * factor)
            changed = motion.model_copy(update={"radius": radius, "pitch": pitch})
            return changed, f"a radius of {format_quantity(radius, 'm')} and a pitch of {format_quantity(pitch, 'm')}"
        case SinusoidMotion():
            amplitude = _round(motion.amplitude * factor)
            return motion.model_copy(
                update={"amplitude": amplitude}
            ), f"an amplitude of {format_quantity(amplitude, 'm')}"
        case StepMotion():
            x, y, z = (_round(factor * value) for value in motion.offset)
            words = f"an offset of {', '.join(format_quantity(value, 'm') for value in (x, y, z))}"
            return motion.model_copy(update={"offset": (x, y, z)}), words
        case WaypointsMotion():
            points = tuple((time, *(factor * value for value in position)) for time, *position in motion.points)
            return motion.model_copy(update={"points": points}), f"offsets {factor:g} times as large"
        case _:
            return None


def _round(value: float) -> float:
    """Return a value rounded to two significant digits."""
    return float(f"{value:.2g}")
