"""Events of a run: state changes, faults, commands. The log panel of Foxglove lists them."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

TOPIC = "/events"
SCHEMA = "foxglove.Log"
#: Severity levels of the message type foxglove.Log.
INFO, WARNING, ERROR, FATAL = 2, 3, 4, 5


class RecordedEvent(NamedTuple):
    """Event of a run: a change of state, a fault, a command, ..."""

    time: float  #: time of the event, on the same clock as the channel `time` [s]
    kind: str  #: state, command, fault, ...
    text: str  #: human-readable text
    level: int = INFO
    data: Mapping[str, Any] = {}  #: machine-readable JSON values


def event_json(event: RecordedEvent, stamp: int) -> bytes:
    """Return an event as the JSON of a foxglove.Log message at `stamp` [ns]."""
    message = {
        "timestamp": {"sec": stamp // 10**9, "nsec": stamp % 10**9},
        "level": event.level,
        "message": event.text,
        "name": event.kind,
        "file": "",
        "line": 0,
        "time": event.time,
        "data": dict(event.data),
    }
    return json.dumps(message, allow_nan=False).encode()


def event_of(message: Mapping[str, Any]) -> RecordedEvent:
    """Return the event from the JSON object of a message that `event_json` has created."""
    return RecordedEvent(message["time"], message["name"], message["message"], message["level"], message["data"])
