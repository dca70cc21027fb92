"""The Foxglove websocket protocol, the part that a server needs who shows and takes nothing: text and bytes, no socket.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md; the SDK's own subprotocol says the same of these.
"""

import json
import struct
from collections.abc import Iterable, Sequence
from typing import Any

from station.recording.data_section import Topic

#: The newest that both sides know is spoken; of these messages they have the same idea.
SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
#: Of a status.
WARNING = 1
#: Of a binary message from the server.
_MESSAGE_DATA = 1

Gains = Iterable[tuple[str, float | str | bool]]


def server_info(session: str) -> str:
    """The first word."""
    return json.dumps({
        "op": "serverInfo", "name": "ctr-station", "capabilities": ["parameters", "parametersSubscribe"],
        "metadata": {}, "sessionId": session,
    })  # fmt: skip


def advertise(topics: Sequence[Topic]) -> str:
    """What may be subscribed to; the id of each is its place, from 1, as in the recordings."""
    channels = [
        {"id": number, "topic": topic.name, "encoding": topic.encoding, "schemaName": topic.schema,
         "schemaEncoding": topic.schema_encoding, "schema": topic.definition}
        for number, topic in enumerate(topics, start=1)
    ]  # fmt: skip
    return json.dumps({"op": "advertise", "channels": channels})


def parameter_values(gains: Gains, request: str | None = None) -> str:
    """Answer to `getParameters`, or news of those that are subscribed to."""
    parameters = [
        {"name": name, "value": value, **({"type": "float64"} if isinstance(value, float) else {})}
        for name, value in gains
    ]
    return json.dumps(
        {"op": "parameterValues", "parameters": parameters, **({} if request is None else {"id": request})}
    )


def status(text: str) -> str:
    """A warning."""
    return json.dumps({"op": "status", "level": WARNING, "message": text})


def message_data(subscription: int, stamp: int, data: bytes) -> bytes:
    """A message of a channel that is subscribed to, of `stamp` [ns] since 1970."""
    return struct.pack("<BIQ", _MESSAGE_DATA, subscription, stamp) + data


def asked(text: str | bytes) -> dict[str, Any]:
    """What a client wants; empty for what is no wish: clients that publish are not heard."""
    if isinstance(text, bytes):
        return {}
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def whole_numbers(values: Any) -> list[int]:
    """Those of a list that are ids."""
    return (
        [value for value in values if type(value) is int and 0 <= value < 1 << 32] if isinstance(values, list) else []
    )


def words(values: Any) -> list[str]:
    """Those of a list that are names."""
    return [value for value in values if isinstance(value, str)] if isinstance(values, list) else []
