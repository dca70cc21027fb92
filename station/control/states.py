"""The station's states and the only ways between them: a table, drawn in `station/README.md`."""

from enum import IntEnum, StrEnum

from core.errors import CtrError


class State(IntEnum):
    """Where the station stands; the number is what telemetry carries."""

    OFF = 0  #: no device is spoken to
    CONNECTED = 1  #: devices answer, positions are not known
    HOMED = 2  #: positions are known
    READY = 3  #: a motion may be started
    RUNNING = 4  #: a motion is on
    HOLD = 5  #: kept in place because something was not right; motors on
    STOPPED = 6  #: stopped by a person
    FAULT = 7  #: stopped by a fault; latched until a person resets it
    CONNECTING = 8  #: devices are being found and set up
    HOMING = 9  #: the stages look for their home sensors


#: What a person has to reset.
LATCHED = (State.HOLD, State.STOPPED, State.FAULT)


class Event(StrEnum):
    """What may happen to the station."""

    CONNECT = "connect"
    CONNECTED = "connected"  #: every device answers
    HOME = "home"
    HOMED = "homed"  #: every position is known
    PREPARE = "prepare"  #: the controller has begun
    START = "start"
    FINISH = "finish"
    HOLD = "hold"
    STOP = "stop"
    FAULT = "fault"
    RESET = "reset"
    RECONNECT = "reconnect"  #: a reset while a device is not right: it is found and set up again


TABLE: dict[tuple[State, Event], State] = {
    (State.OFF, Event.CONNECT): State.CONNECTING,
    (State.CONNECTING, Event.CONNECTED): State.CONNECTED,
    (State.CONNECTED, Event.HOME): State.HOMING,
    # Stages that were homed before and have kept their power know where they are.
    (State.CONNECTED, Event.HOMED): State.HOMED,
    (State.HOMING, Event.HOMED): State.HOMED,
    (State.HOMED, Event.PREPARE): State.READY,
    (State.READY, Event.HOME): State.HOMING,
    (State.READY, Event.START): State.RUNNING,
    (State.RUNNING, Event.FINISH): State.READY,
    (State.RUNNING, Event.HOLD): State.HOLD,
    (State.READY, Event.HOLD): State.HOLD,
    (State.HOLD, Event.RESET): State.READY,
    (State.STOPPED, Event.RESET): State.READY,
    (State.HOLD, Event.RECONNECT): State.CONNECTING,
    (State.STOPPED, Event.RECONNECT): State.CONNECTING,
    # A fault may have lost devices or positions: connect again, and home what has to be.
    (State.FAULT, Event.RESET): State.CONNECTING,
    # STOP is accepted everywhere; where nothing can move it changes nothing.
    (State.OFF, Event.STOP): State.OFF,
    (State.CONNECTING, Event.STOP): State.OFF,
    (State.CONNECTED, Event.STOP): State.CONNECTED,
    (State.HOMING, Event.STOP): State.CONNECTED,
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
