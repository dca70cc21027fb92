"""What happened during a run: state changes, faults, commands. Foxglove's log panel lists them."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

TOPIC = "/events"
SCHEMA = "foxglove.Log"
#: Levels of foxglove.Log.
INFO, WARNING, ERROR, FATAL = 2, 3, 4, 5


class Event(NamedTuple):
    """Something that happened."""

    time: float  #: as the rows' channel `time` has it [s]
    kind: str  #: state, command, fault, ...
    text: str  #: for a person
    level: int = INFO
    data: Mapping[str, Any] = {}  #: for a program; what JSON can say


def event_json(event: Event, stamp: int) -> bytes:
    """The message for an event that happened at `stamp` [ns]."""
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


def event_of(message: Mapping[str, Any]) -> Event:
    """Inverse of `event_json`."""
    return Event(message["time"], message["name"], message["message"], message["level"], message["data"])
