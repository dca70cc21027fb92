"""Lights of the devices and punctuality of the loop, as HTML."""

import numpy as np

from station.states import State
from station.supervisor import STALE, Status
from web.history import History
from web.palette import GREEN, css
from web.words import GREY, RED


def health(status: Status, history: History) -> str:
    """One light a device, and a table of the control loop's timing."""
    alive = bool(status.values) and status.age <= STALE and status.state is not State.OFF
    frame = history.frame_age if np.isfinite(history.frame_age) else 0.0
    lights = "".join(
        (
            _light("Stages", alive, f"positions {_age(status.age)} old"),
            _light("Tracker", alive and frame <= STALE, f"newest frame {_age(status.age + frame)} old"),
            _light("Force sensors", alive, f"samples {_age(status.age)} old"),
        )
    )
    timing = status.timing
    rows = _row("late", timing.late_us) + _row("work", timing.tick_us)
    return (
        f'<div style="padding:8px 12px;font-size:13px;line-height:1.5">{lights}'
        '<div style="margin-top:8px;font-weight:600">Control loop, 500 Hz</div>'
        '<table style="width:100%;border-spacing:0;text-align:right"><tr style="color:#495057">'
        f"<td></td><td>p50 [µs]</td><td>p99 [µs]</td><td>max [µs]</td></tr>{rows}</table>"
        f'<div style="color:#495057">{timing.ticks} ticks, {timing.missed} periods missed,'
        f" {timing.scheduler}</div></div>"
    )


def _row(name: str, microseconds: dict[str, float]) -> str:
    cells = "".join(f"<td>{microseconds[key]:.0f}</td>" for key in ("p50", "p99", "max"))
    return f'<tr><td style="text-align:left">{name}</td>{cells}</tr>'


def _light(name: str, good: bool, text: str) -> str:
    colour, word = (css(GREEN), "ok") if good else (css(RED), "stale")
    return (
        f'<div><span style="display:inline-block;width:10px;height:10px;border-radius:5px;background:{colour}"></span>'
        f' <b>{name}</b> {word} <span style="color:{css(GREY)}">{text}</span></div>'
    )


def _age(seconds: float) -> str:
    """Coarse, so that it does not flicker."""
    if seconds < 0.1:
        return "under 0.1 s"
    return f"{seconds:.1f} s" if seconds < 60.0 else f"{seconds / 60.0:.0f} min"
