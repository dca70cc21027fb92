"""State of the station in words: what it does, why, and what a person can do next."""

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from station.control.loop import Phase
from station.control.states import State
from station.service.status import STALE, Status

Act = Literal["", "connect", "home", "reset", "start", "calibrate"]


class Words(NamedTuple):
    """For a person's eyes."""

    what: str  #: what is going on, or the cause
    next: str  #: what to do; empty when there is nothing to do
    act: Act = ""  #: the same as the command or the tab that does it


_PHASES = {
    Phase.NONE: "starting",
    Phase.APPROACHING: "going to the start pose",
    Phase.SETTLING: "at rest: zeroing the force sensors, averaging the start tip",
    Phase.MOVING: "executing the trajectory",
    Phase.JOGGING: "moved by hand",
}
_QUIET = {
    "OFF": Words("no device is spoken to", "connect the devices", "connect"),
    "CONNECTING": Words("devices are being found and set up", "wait; STOP ends it"),
    "CONNECTED": Words("devices answer, positions are not known", "home the stages", "home"),
    "HOMING": Words("the stages look for their home sensors", "wait; STOP ends it"),
    "HOMED": Words("positions are known, the controller begins", "wait"),
    "READY": Words("nothing moves", "choose a motion and press Start", "start"),
}


_TOLD = {"joint", "number", "of", "gone", "way", "exact", "unit", "left_s"}


def words(status: Status) -> Words:
    """The state in words; old telemetry is called so whatever the state."""
    state, cause = status.state, status.cause
    if state is State.FAULT:
        return Words(
            cause or "unknown cause", "" if "reset" in cause.lower() else "find the cause, then Reset", "reset"
        )
    if status.age > STALE and state is not State.OFF:
        return Words(
            f"no telemetry for {status.age:.0f} s; it was {state.name}",
            "press STOP; restart the station if this stays",
        )
    if state is State.RUNNING:
        if status.phase is Phase.APPROACHING and status.run is not None and not status.run.start.task.rests:
            return Words(f"going {status.run.start.title}", "STOP ends it")
        return Words(_PHASES[status.phase], "")
    if state in (State.HOLD, State.STOPPED):
        return Words(cause or "cause unknown", "look at the bench, then Reset", "reset")
    if state is State.READY and status.reserved:
        return Words(status.reserved, "see the tab Calibrate", "calibrate")
    if state is State.HOMING:
        return _QUIET[state.name]._replace(what=_homing(status) or _QUIET[state.name].what)
    return _QUIET[state.name]


def _homing(status: Status) -> str:
    """Which axis, how far, how long, where the stages' driver tells as ours does; else nothing."""
    told = next((device.details.get("homing") for device in status.devices if device.name == "stages"), None)
    if not isinstance(told, Mapping) or not told.keys() >= _TOLD:
        return ""
    scale, unit = (1e3, "mm") if told["unit"] == "m" else (180.0 / math.pi, "deg")
    axis, most = told["joint"].replace("_", " "), "" if told["exact"] else "at most "
    return (
        f"homing {axis} ({told['number']} of {told['of']}): {scale * told['gone']:.0f} of {most}"
        f"{scale * told['way']:.0f} {unit}; about {told['left_s']:.0f} s left"
    )
