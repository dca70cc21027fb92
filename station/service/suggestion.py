"""What would work instead of a motion that cannot be followed: slower first, then smaller, tried on the model."""

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
)
from station.config.units import shown

#: How many times slower, and which part of the size, is tried, the mildest change first.
SLOWER = (1.25, 1.5, 2.0, 3.0, 5.0)
SMALLER = (0.8, 0.6, 0.4, 0.2)

#: Where nothing that was tried works.
MORE_ROOM = "from the robot's working pose there is more room: go there first (tab Jog, or POST /api/goto)"

Change = Callable[[TipMotion, float], tuple[TipMotion, str] | None]


def suggestion(motion: TipMotion, controller: Controller, joints: Array, duration: float) -> str:
    """A value that would work from `joints` (n,) [rad or m]; empty when none of those tried does.

    Args:
        motion: that cannot be followed.
        controller: its model and limits are what others are tried on.
        joints: where it would start.
        duration: of the motion [s]; slower waypoints take longer.
    """
    for change, factors in ((_slower, SLOWER), (_smaller, SMALLER)):
        for factor in factors:
            changed = change(motion, factor)
            if changed is None:
                break
            other, words = changed
            longer = duration * factor if isinstance(motion, WaypointsMotion) and change is _slower else duration
            try:
                other = type(other).model_validate(other.model_dump())
                Orders(other, controller.statics.robot).check(controller, joints, longer)
            except (CtrError, ValidationError):
                continue
            return f"{words} would work from here"
    return ""


def _slower(motion: TipMotion, factor: float) -> tuple[TipMotion, str] | None:
    """`factor` times as slow; None for what has no pace."""
    match motion:
        case CircleMotion():
            period = _round(motion.period * factor)
            return motion.model_copy(update={"period": period}), f"a period of {shown(period, 's')}"
        case HelixMotion():
            turn = _round(motion.turn * factor)
            return motion.model_copy(update={"turn": turn}), f"{shown(turn, 's')} for one turn"
        case SinusoidMotion():
            frequency = _round(motion.frequency / factor)
            return motion.model_copy(update={"frequency": frequency}), f"a frequency of {shown(frequency, 'Hz')}"
        case WaypointsMotion():
            points = tuple((time * factor, *place) for time, *place in motion.points)
            return motion.model_copy(update={"points": points}), f"times {factor:g} times as long"
        case _:
            return None


def _smaller(motion: TipMotion, factor: float) -> tuple[TipMotion, str] | None:
    """`factor` of its size; None for what has none."""
    match motion:
        case CircleMotion():
            radius = _round(motion.radius * factor)
            return motion.model_copy(update={"radius": radius}), f"a radius of {shown(radius, 'm')}"
        case HelixMotion():
            radius, pitch = _round(motion.radius * factor), _round(motion.pitch * factor)
            changed = motion.model_copy(update={"radius": radius, "pitch": pitch})
            return changed, f"a radius of {shown(radius, 'm')} and a pitch of {shown(pitch, 'm')}"
        case SinusoidMotion():
            amplitude = _round(motion.amplitude * factor)
            return motion.model_copy(update={"amplitude": amplitude}), f"an amplitude of {shown(amplitude, 'm')}"
        case StepMotion():
            x, y, z = (_round(factor * value) for value in motion.offset)
            words = f"an offset of {', '.join(shown(value, 'm') for value in (x, y, z))}"
            return motion.model_copy(update={"offset": (x, y, z)}), words
        case WaypointsMotion():
            points = tuple((time, *(factor * value for value in place)) for time, *place in motion.points)
            return motion.model_copy(update={"points": points}), f"offsets {factor:g} times as large"
        case _:
            return None


def _round(value: float) -> float:
    """To two digits, as a person would choose it."""
    return float(f"{value:.2g}")
