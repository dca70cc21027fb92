"""The station's states and the only ways between them: a table, drawn in `README.md`."""

from enum import IntEnum, StrEnum

from core.errors import CtrError


class State(IntEnum):
    """Where the station stands; the number is what telemetry carries."""

    OFF = 0  #: no device is open
    CONNECTED = 1  #: devices answer, positions are not known
    HOMED = 2  #: positions are known
    READY = 3  #: a motion may be started
    RUNNING = 4  #: a motion is on
    HOLD = 5  #: kept in place because something was not right; motors on
    STOPPED = 6  #: stopped by a person
    FAULT = 7  #: stopped by a fault; latched until a person resets it


class Event(StrEnum):
    """What may happen to the station."""

    CONNECT = "connect"
    HOME = "home"
    PREPARE = "prepare"
    START = "start"
    FINISH = "finish"
    HOLD = "hold"
    STOP = "stop"
    FAULT = "fault"
    RESET = "reset"
    DISCONNECT = "disconnect"


TABLE: dict[tuple[State, Event], State] = {
    (State.OFF, Event.CONNECT): State.CONNECTED,
    (State.CONNECTED, Event.HOME): State.HOMED,
    (State.HOMED, Event.PREPARE): State.READY,
    (State.READY, Event.START): State.RUNNING,
    (State.RUNNING, Event.FINISH): State.READY,
    (State.RUNNING, Event.HOLD): State.HOLD,
    (State.READY, Event.HOLD): State.HOLD,
    (State.HOLD, Event.RESET): State.READY,
    (State.STOPPED, Event.RESET): State.READY,
    # A fault may have lost positions: home again.
    (State.FAULT, Event.RESET): State.CONNECTED,
    (State.CONNECTED, Event.DISCONNECT): State.OFF,
    (State.HOMED, Event.DISCONNECT): State.OFF,
    (State.READY, Event.DISCONNECT): State.OFF,
    (State.HOLD, Event.DISCONNECT): State.OFF,
    (State.STOPPED, Event.DISCONNECT): State.OFF,
    (State.FAULT, Event.DISCONNECT): State.OFF,
    # STOP is accepted everywhere; where nothing can move it changes nothing.
    (State.OFF, Event.STOP): State.OFF,
    (State.CONNECTED, Event.STOP): State.CONNECTED,
    (State.HOMED, Event.STOP): State.HOMED,
    (State.READY, Event.STOP): State.STOPPED,
    (State.RUNNING, Event.STOP): State.STOPPED,
    (State.HOLD, Event.STOP): State.STOPPED,
    (State.STOPPED, Event.STOP): State.STOPPED,
    (State.FAULT, Event.STOP): State.FAULT,
    **{(state, Event.FAULT): State.FAULT for state in State if state is not State.OFF},
}


class RefusedError(CtrError):
    """An event that the present state does not allow."""


def after(state: State, event: Event) -> State:
    """The state that follows.

    Raises:
        RefusedError: not from this state; the text says from which.
    """
    if (state, event) not in TABLE:
        allowed = " or ".join(origin.name for origin, possible in TABLE if possible is event)
        raise RefusedError(f"'{event}' is not possible while {state.name}; it needs {allowed}")
    return TABLE[state, event]
