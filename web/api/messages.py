"""State of the station in words: what it does, why, and what a person can do next."""

from typing import NamedTuple

from station.control.loop import Phase
from station.control.states import State
from station.service.status import STALE, Status


class Words(NamedTuple):
    """For a person's eyes."""

    what: str  #: what is going on, or the cause
    next: str  #: what to do; empty when there is nothing to do


_PHASES = {
    Phase.NONE: "starting",
    Phase.APPROACHING: "going to the start pose",
    Phase.SETTLING: "at rest: zeroing the force sensors, averaging the start tip",
    Phase.MOVING: "executing the trajectory",
    Phase.JOGGING: "moved by hand",
}
_QUIET = {
    "OFF": Words("no device is spoken to", "connect the devices"),
    "CONNECTING": Words("devices are being found and set up", "wait; STOP ends it"),
    "CONNECTED": Words("devices answer, positions are not known", "home the stages"),
    "HOMING": Words("the stages look for their home sensors", "wait; STOP ends it"),
    "HOMED": Words("positions are known, the controller begins", "wait"),
    "READY": Words("nothing moves", "choose a motion and press Start"),
}


def words(status: Status) -> Words:
    """The state in words; old telemetry is called so whatever the state."""
    state, cause = status.state, status.cause
    if state is State.FAULT:
        return Words(cause or "unknown cause", "" if "reset" in cause.lower() else "find the cause, then Reset")
    if status.age > STALE and state is not State.OFF:
        return Words(
            f"no telemetry for {status.age:.0f} s; it was {state.name}",
            "press STOP; restart the station if this stays",
        )
    if state is State.RUNNING:
        if status.phase is Phase.APPROACHING and status.run is not None and status.run.start.task.duration == 0.0:
            return Words(f"going {status.run.start.title}", "STOP ends it")
        return Words(_PHASES[status.phase], "")
    if state in (State.HOLD, State.STOPPED):
        return Words(cause or "cause unknown", "look at the bench, then Reset")
    if state is State.READY and status.reserved:
        return Words(status.reserved, "see the tab Calibrate")
    return _QUIET[state.name]
