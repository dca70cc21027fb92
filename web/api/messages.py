"""Messages for each state of the station: what the station does, why, and what the operator can do next."""

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from station.control.loop import Phase
from station.control.realtime import load
from station.control.states import State
from station.service.status import STALE_AFTER_S, StationStatus

Action = Literal["", "connect", "home", "reset", "start", "calibrate"]


class StateMessage(NamedTuple):
    """Message that the page shows for the station's state."""

    message: str  #: what the station does, or why it has stopped
    next: str  #: what the operator should do; empty if nothing
    action: Action = ""  #: command or tab of the page that does what `next` says


_PHASES = {
    Phase.NONE: "starting",
    Phase.APPROACHING: "going to the start pose",
    Phase.SETTLING: "at rest: zeroing the force sensors, averaging the start tip",
    Phase.MOVING: "executing the trajectory",
    Phase.JOGGING: "jogging",
}
_IDLE_MESSAGES = {
    "OFF": StateMessage("devices are not connected", "connect the devices", "connect"),
    "CONNECTING": StateMessage("finding and setting up the devices", "wait, or press STOP"),
    "CONNECTED": StateMessage("devices are connected, positions are unknown", "home the stages", "home"),
    "HOMING": StateMessage("the stages search for their home sensors", "wait, or press STOP"),
    "HOMED": StateMessage("positions are known, the controller is starting", "wait"),
    "READY": StateMessage("nothing moves", "choose a motion and press Start", "start"),
}


_HOMING_KEYS = {"joint", "number", "of", "gone", "way", "exact", "unit", "left_s"}


def state_message(status: StationStatus) -> StateMessage:
    """Return the message for the station's status; it reports missing telemetry in every state except OFF and FAULT."""
    state, cause = status.state, status.cause
    if state is State.FAULT:
        return StateMessage(
            cause or "unknown cause", "" if "reset" in cause.lower() else "find the cause, then press Reset", "reset"
        )
    if status.age > STALE_AFTER_S and state is not State.OFF:
        return StateMessage(
            f"no telemetry for {status.age:.0f} s; the last state was {state.name}; {load()}",
            "press STOP; end other programs on this computer; restart the station if this persists",
        )
    if state is State.RUNNING:
        if status.phase is Phase.APPROACHING and status.run is not None and not status.run.start.task.rests:
            return StateMessage(f"going {status.run.start.title}", "press STOP to end it")
        return StateMessage(_PHASES[status.phase], "")
    if state in (State.HOLD, State.STOPPED):
        return StateMessage(cause or "unknown cause", "check the rig, then press Reset", "reset")
    if state is State.READY and status.reserved:
        return StateMessage(status.reserved, "open the tab Calibrate", "calibrate")
    if state is State.HOMING:
        return _IDLE_MESSAGES[state.name]._replace(message=_homing(status) or _IDLE_MESSAGES[state.name].message)
    return _IDLE_MESSAGES[state.name]


def _homing(status: StationStatus) -> str:
    """Return the homing axis, its distance and the time left; empty if the driver does not report all of them."""
    homing = next((device.details.get("homing") for device in status.devices if device.name == "stages"), None)
    if not isinstance(homing, Mapping) or not homing.keys() >= _HOMING_KEYS:
        return ""
    scale, unit = (1e3, "mm") if homing["unit"] == "m" else (180.0 / math.pi, "deg")
    axis, at_most = homing["joint"].replace("_", " "), "" if homing["exact"] else "at most "
    return (
        f"homing {axis} ({homing['number']} of {homing['of']}): {scale * homing['gone']:.0f} of {at_most}"
        f"{scale * homing['way']:.0f} {unit}; about {homing['left_s']:.0f} s left"
    )
