"""State of the station in words: what it does, why, and what a person can do next."""

from html import escape
from typing import NamedTuple

from station.loop import Phase
from station.states import State
from station.supervisor import STALE, Status
from web import palette


class Words(NamedTuple):
    """For a person's eyes."""

    state: str
    colour: palette.Colour
    what: str  #: what is going on, or the cause
    next: str  #: what to do; empty when there is nothing to do


GREY: palette.Colour = (110, 118, 128)
RED: palette.Colour = (192, 28, 40)

_PHASES = {
    Phase.NONE: "starting",
    Phase.APPROACHING: "going to the start pose",
    Phase.SETTLING: "at rest: zeroing the force sensors, averaging the start tip",
    Phase.MOVING: "the motion is on",
}


def words(status: Status) -> Words:
    """The state in words; old telemetry is called so whatever the state."""
    state, cause = status.state, status.cause
    if state is State.FAULT:
        return Words(
            "FAULT", RED, cause or "unknown cause", "" if "reset" in cause.lower() else "find the cause, then Reset"
        )
    if state is State.OFF:
        return Words("OFF", GREY, "the control process is coming up", "wait a few seconds")
    if status.age > STALE:
        return Words(
            "STALE",
            RED,
            f"no telemetry for {status.age:.0f} s; it was {state.name}",
            "press STOP; restart the station if this stays",
        )
    if state is State.RUNNING:
        return Words("RUNNING", palette.BLUE, _PHASES[status.phase], "")
    if state is State.READY:
        return Words("READY", palette.GREEN, "nothing moves", "choose a motion and press Start")
    if state in (State.HOLD, State.STOPPED):
        return Words(state.name, palette.VERMILLION, cause or "cause unknown", "look at the bench, then Reset")
    return Words(
        state.name, GREY, "devices answer" if state is State.CONNECTED else "positions are known", "make it ready first"
    )


def card(status: Status, duration: float) -> str:
    """HTML: the state, the run, the cause, what to do next, and how far a motion of `duration` [s] has come."""
    said, left = words(status), time_left(status, duration)
    colour, done = palette.css(said.colour), 100.0 * status.progress if left else 0.0
    return (
        '<div style="padding:8px 12px 6px;font-size:13px;line-height:1.35">'
        f'<span style="background:{colour};color:#fff;font-weight:700;padding:2px 10px;border-radius:4px;'
        f'letter-spacing:.04em">{said.state}</span>'
        f' <span style="margin-left:6px;font-weight:600">{escape(status.title) or "no run yet"}</span>'
        f'<div style="margin-top:6px;min-height:36px"><span style="color:{colour}">{escape(said.what)}</span>'
        f'<br><span style="color:#495057">{escape(said.next)}</span></div>'
        '<div style="background:#e9ecef;height:8px;border-radius:4px;overflow:hidden;margin-top:4px">'
        f'<div style="background:{colour};height:100%;width:{done:.1f}%"></div></div>'
        f'<div style="color:#495057;font-size:12px;min-height:16px;margin-top:2px">{left}</div></div>'
    )


def time_left(status: Status, duration: float) -> str:
    """E.g. `0:42 left of 3:20`; `duration` of the motion [s]."""
    if status.state is not State.RUNNING or status.phase is not Phase.MOVING:
        return ""
    return f"{_clock((1.0 - status.progress) * duration)} left of {_clock(duration)}"


def _clock(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60}:{whole % 60:02d}"
