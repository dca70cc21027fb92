"""States of the station, the table of their transitions (drawn in `station/README.md`), and causes of a stop."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum

from core.errors import CtrError


class State(IntEnum):
    """State of the station; telemetry contains its number."""

    OFF = 0  #: no device is connected to the station
    CONNECTED = 1  #: all devices answer, joint positions are not known
    HOMED = 2  #: the positions of all joints are known
    READY = 3  #: a motion may be started
    RUNNING = 4  #: a run, a jog or another motion is active
    HOLD = 5  #: position kept after a fault or a limit; motors on
    STOPPED = 6  #: motion was stopped by a person
    FAULT = 7  #: stopped by a fault; latched until a person resets it
    CONNECTING = 8  #: the station searches for its devices and sets them up
    HOMING = 9  #: the stages search their home sensors


#: States that a person must reset.
LATCHED = (State.HOLD, State.STOPPED, State.FAULT)
#: States in which the stages may move.
MOVING = (State.RUNNING, State.HOMING)
#: States that end by themselves when devices, stages or controller become ready.
AUTO_STATES = (State.CONNECTING, State.CONNECTED, State.HOMING, State.HOMED)


class Transition(StrEnum):
    """Event that changes the state of the station."""

    CONNECT = "connect"
    CONNECTED = "connected"  #: every device answers
    HOME = "home"
    HOMED = "homed"  #: the position of every joint is known
    PREPARE = "prepare"  #: the controller has started
    START = "start"
    FINISH = "finish"
    HOLD = "hold"
    STOP = "stop"
    FAULT = "fault"
    RESET = "reset"
    RECONNECT = "reconnect"  #: a reset while the tracker or a sensor has a fault, which is then connected again


TRANSITIONS: dict[tuple[State, Transition], State] = {
    (State.OFF, Transition.CONNECT): State.CONNECTING,
    (State.CONNECTING, Transition.CONNECTED): State.CONNECTED,
    (State.CONNECTED, Transition.HOME): State.HOMING,
    # Stages that were homed earlier and have kept their power still know their positions, so homing is not needed.
    (State.CONNECTED, Transition.HOMED): State.HOMED,
    (State.HOMING, Transition.HOMED): State.HOMED,
    (State.HOMED, Transition.PREPARE): State.READY,
    (State.READY, Transition.HOME): State.HOMING,
    (State.READY, Transition.START): State.RUNNING,
    (State.RUNNING, Transition.FINISH): State.READY,
    (State.RUNNING, Transition.HOLD): State.HOLD,
    (State.READY, Transition.HOLD): State.HOLD,
    (State.HOLD, Transition.RESET): State.READY,
    (State.STOPPED, Transition.RESET): State.READY,
    (State.HOLD, Transition.RECONNECT): State.CONNECTING,
    (State.STOPPED, Transition.RECONNECT): State.CONNECTING,
    # A fault may have lost devices or positions, so every device is connected again and stages may have to be homed.
    (State.FAULT, Transition.RESET): State.CONNECTING,
    # STOP is accepted in every state. In states without motion it does not change the state.
    (State.OFF, Transition.STOP): State.OFF,
    (State.CONNECTING, Transition.STOP): State.OFF,
    (State.CONNECTED, Transition.STOP): State.CONNECTED,
    (State.HOMING, Transition.STOP): State.CONNECTED,
    (State.HOMED, Transition.STOP): State.HOMED,
    (State.READY, Transition.STOP): State.STOPPED,
    (State.RUNNING, Transition.STOP): State.STOPPED,
    (State.HOLD, Transition.STOP): State.STOPPED,
    (State.STOPPED, Transition.STOP): State.STOPPED,
    (State.FAULT, Transition.STOP): State.FAULT,
    **{(state, Transition.FAULT): State.FAULT for state in State if state is not State.OFF},
}


class RefusedError(CtrError):
    """The present state of the station does not allow a request."""


def origins(event: Transition) -> tuple[State, ...]:
    """Return the states in which an event is possible."""
    return tuple(state for state, possible in TRANSITIONS if possible is event)


def check_state(state: State, what: str, allowed: Sequence[State]) -> None:
    """Check that `state` is one of the states that allow the event or command `what`.

    Raises:
        RefusedError: it is not; the text names the states that allow it.
    """
    if state not in allowed:
        needed = " or ".join(each.name for each in allowed)
        raise RefusedError(f"'{what}' is not possible while {state.name}; it needs {needed}")


def next_state(state: State, event: Transition) -> State:
    """Return the state that follows from an event.

    Raises:
        RefusedError: the event is not possible in this state; the text names the states that allow it.
    """
    check_state(state, event, origins(event))
    return TRANSITIONS[state, event]


@dataclass(frozen=True)
class StopReasons:
    """Causes of HOLD, STOP or FAULT since the last reset, in their order, each once."""

    texts: tuple[str, ...] = ()
    every_detail: tuple[str, ...] = ()  #: addresses and raw values of each cause; empty texts where there are none

    def add(self, text: str, details: str = "") -> "StopReasons":
        """Return the causes with one more; a cause that is already known is not added again."""
        if not text or text in self.texts:
            return self
        return StopReasons((*self.texts, text), (*self.every_detail, details))

    def extend(self, text: str, details: str = "") -> "StopReasons":
        """Return the causes with `text` in place of the cause that `text` starts with.

        The text of a lost serial link grows, because the axes miss their polls one after the other.
        """
        pairs = [
            (text, details) if text.startswith(known) else (known, about)
            for known, about in zip(self.texts, self.every_detail, strict=True)
        ]
        return StopReasons(tuple(text for text, _ in pairs), tuple(details for _, details in pairs))

    @property
    def details(self) -> str:
        """Addresses and raw values of all causes in one line."""
        return "; then ".join(filter(None, self.every_detail))

    def __str__(self) -> str:
        return "; then ".join(self.texts)
