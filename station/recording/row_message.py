"""Telemetry row as an MCAP message, which keeps every bit and which Foxglove can read at the full rate.

The payload is the row as consecutive little-endian float64 numbers. ROS 1 serialises a message of float64 fields in the
same form, so the schema is a ROS 1 message definition: a field for each channel, a nested message for each group, and
the unit as a comment. No ROS is needed: `numpy.frombuffer(data, "<f8")` is the row, in the order of the schema.
"""

import re
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from core.robot.robot import Array
from station.control.telemetry import Channel

TOPIC = "/telemetry"
SCHEMA = "ctr_station/Telemetry"
#: Length of an MCAP message record before its payload: opcode, length, topic, sequence number and two times [bytes].
MESSAGE_HEADER_BYTES = 31


class Rows(NamedTuple):
    """Consecutive message records, one for each row, with their offsets."""

    times: NDArray[np.uint64]  #: time of each row (n,) [ns]
    records: bytes
    offsets: NDArray[np.uint64]  #: offset of each record from the start of `records` (n,) [bytes]


NO_ROWS = Rows(np.empty(0, np.uint64), b"", np.empty(0, np.uint64))


def definition(channels: Sequence[Channel]) -> str:
    """Return the ROS 1 message definition of a row with these channels."""
    main: list[str] = []
    parts: list[str] = []
    fields, types = _Names(), _Names()
    for group, members in _grouped(channels):
        if members[0][0] == "":
            main.append(f"float64 {fields.of(group)}{_comment(members[0][1])}")
            continue
        kind = types.of("".join(word.capitalize() for word in _identifier(group).split("_")))
        main.append(f"{kind} {fields.of(group)}")
        inner = _Names()
        parts.append(f"{'=' * 80}\nMSG: ctr_station/{kind}")
        parts += [f"float64 {inner.of(name)}{_comment(channel)}" for name, channel in members]
    return "\n".join((*main, *parts)) + "\n"


def message_records(rows: Array, times: NDArray[np.uint64], topic: int, first: int) -> Rows:
    """Return the MCAP message records of telemetry rows (n, width).

    Args:
        rows: recorded rows.
        times: time of each row (n,) [ns].
        topic: MCAP channel id.
        first: sequence number of the first row.
    """
    count, width = rows.shape
    records = np.empty(count, _record(width))
    records["opcode"], records["length"] = Opcode.MESSAGE, records.itemsize - 9
    records["topic"] = topic
    records["sequence"] = np.arange(first, first + count, dtype=np.uint64)
    records["log_time"] = records["publish_time"] = times
    records["row"] = rows
    return Rows(times, records.tobytes(), np.arange(count, dtype=np.uint64) * np.uint64(records.itemsize))


def row_of(payload: bytes) -> Array:
    """Return the telemetry row in the payload of a message."""
    return np.frombuffer(payload, "<f8")


def _record(width: int) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("topic", "<u2"),
            ("sequence", "<u4"),
            ("log_time", "<u8"),
            ("publish_time", "<u8"),
            ("row", "<f8", (width,)),
        ]
    )


def _grouped(channels: Sequence[Channel]) -> Iterator[tuple[str, list[tuple[str, Channel]]]]:
    """Yield the name of each channel group with its members.

    A channel without a group is a group with a single member, whose name is empty.
    """

    def group(channel: Channel) -> str:
        return channel.name.rpartition(".")[0] or channel.name

    for name, members in groupby(channels, group):
        listed = list(members)
        alone = listed[0].name == name
        yield name, [("" if alone else channel.name.rpartition(".")[2], channel) for channel in listed]


def _comment(channel: Channel) -> str:
    return f"  # [{channel.unit}]" if channel.unit else ""


def _identifier(name: str) -> str:
    """Return the name as a valid name of a ROS field."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if plain[:1].isalpha() else f"c_{plain}"


class _Names:
    """Makes ROS field names unique after their conversion to letters, digits and underscores."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def of(self, name: str) -> str:
        plain = base = _identifier(name)
        number = 2
        while plain in self._taken:
            plain, number = f"{base}_{number}", number + 1
        self._taken.add(plain)
        return plain
