"""Encoding of the Foxglove WebSocket protocol for a server that only sends data; this module opens no socket.

The protocol is specified at https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md. Its subprotocol
`foxglove.websocket.v1` and the subprotocol of Foxglove's SDK, `foxglove.sdk.v1`, have the same messages.
"""

import json
import struct
from collections.abc import Iterable, Sequence
from typing import Any

from station.recording.data_section import Topic

#: Names of the supported WebSocket subprotocols, newest first; both define the same messages.
SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
#: Level of a status message that reports a warning.
WARNING_LEVEL = 1
#: First byte of the server's binary message that contains data of a subscribed channel.
_MESSAGE_DATA = 1

Gains = Iterable[tuple[str, float | str | bool]]


def server_info(session: str) -> str:
    """Return the first message to a client: the server's name and capabilities."""
    return json.dumps({
        "op": "serverInfo", "name": "ctr-station", "capabilities": ["parameters", "parametersSubscribe"],
        "metadata": {}, "sessionId": session,
    })  # fmt: skip


def advertise(topics: Sequence[Topic]) -> str:
    """Return the message that lists the channels; a channel's id is its position, from 1, as in the recordings."""
    channels = [
        {"id": number, "topic": topic.name, "encoding": topic.encoding, "schemaName": topic.schema,
         "schemaEncoding": topic.schema_encoding, "schema": topic.definition}
        for number, topic in enumerate(topics, start=1)
    ]  # fmt: skip
    return json.dumps({"op": "advertise", "channels": channels})


def parameter_values(gains: Gains, request: str | None = None) -> str:
    """Return the message with the controller's parameters: the answer to a `request`, or an update without one."""
    parameters = [
        {"name": name, "value": value, **({"type": "float64"} if isinstance(value, float) else {})}
        for name, value in gains
    ]
    return json.dumps(
        {"op": "parameterValues", "parameters": parameters, **({} if request is None else {"id": request})}
    )


def status(text: str) -> str:
    """Return a status message that shows `text` as a warning."""
    return json.dumps({"op": "status", "level": WARNING_LEVEL, "message": text})


def message_data(subscription: int, stamp: int, data: bytes) -> bytes:
    """Return a message of a subscribed channel with its time `stamp` [ns] since 1970."""
    return struct.pack("<BIQ", _MESSAGE_DATA, subscription, stamp) + data


def client_requests(text: str | bytes) -> dict[str, Any]:
    """Return the request of a client; empty if it is invalid or publishes data."""
    if isinstance(text, bytes):
        return {}
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def whole_numbers(values: Any) -> list[int]:
    """Return the entries of a list that are valid channel or subscription ids."""
    return (
        [value for value in values if type(value) is int and 0 <= value < 1 << 32] if isinstance(values, list) else []
    )


def string_list(values: Any) -> list[str]:
    """Return the entries of a list that are strings."""
    return [value for value in values if isinstance(value, str)] if isinstance(values, list) else []
