"""CDR, the wire format of ROS 2: encode and decode messages whose type is defined by a text.

A message starts with four bytes for the encoding (XCDR 1); numbers are aligned to their size, counted from the end of
these bytes. A value is a tuple of the values of its fields; a sequence of structures of float64 may be an array.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from core.errors import CtrError

#: Format of each number for `struct`.
_NUMBERS = {
    "bool": "?", "uint8": "B", "int32": "i", "uint32": "I", "float32": "f", "float64": "d",
}  # fmt: skip
_LITTLE_ENDIAN, _BIG_ENDIAN = b"\x00\x01\x00\x00", b"\x00\x00\x00\x00"
#: Largest message that is decoded [bytes], and the most bytes of padding after its last field.
MAX_MESSAGE_BYTES, MAX_PADDING_BYTES = 16 * 1024, 3


class BadMessage(CtrError):
    """Received bytes are no valid message of their type."""


class Part(NamedTuple):
    """One field of a message type."""

    name: str
    kind: "str | tuple[Part, ...]"  #: name of a number's format, 'string', or the fields of a structure
    many: bool  #: whether the field is a sequence


Layout = tuple[Part, ...]  #: fields of a message type in their order


def layout_of(name: str, definitions: Mapping[str, str]) -> Layout:
    """Return the layout of a message type from the definitions of this type and of all nested types by name."""
    parts = list[Part]()
    for line in definitions[name].splitlines():
        kind, field = line.split()
        base = kind.removesuffix("[]")
        known = base == "string" or base in _NUMBERS
        parts.append(Part(field, base if known else layout_of(base, definitions), base != kind))
    # ROS 2 gives a structure without fields one byte.
    return tuple(parts) or (Part("structure_needs_at_least_one_member", "uint8", many=False),)


def blank(layout: Layout) -> tuple[Any, ...]:
    """Return the value of a message without content: zeros and empty texts and sequences."""
    empty = {"string": "", "bool": False}
    return tuple(
        () if part.many else empty.get(part.kind, 0) if isinstance(part.kind, str) else blank(part.kind)
        for part in layout
    )


def _doubles(layout: Layout) -> bool:
    """Return whether a structure consists of float64 alone, so that a sequence of it is an array of numbers."""
    return all(part.kind == "float64" and not part.many for part in layout)


def encode(layout: Layout, value: Sequence[Any]) -> bytes:
    """Return the bytes of a message."""
    data = bytearray()
    _write(data, layout, value)
    return _LITTLE_ENDIAN + bytes(data)


def _write(data: bytearray, layout: Layout, value: Sequence[Any]) -> None:
    for part, each in zip(layout, value, strict=True):
        if not part.many:
            _write_one(data, part.kind, each)
            continue
        _write_one(data, "uint32", len(each))
        if len(each) and (part.kind == "float64" or (not isinstance(part.kind, str) and _doubles(part.kind))):
            data += bytes(-len(data) % 8)
            data += np.asarray(each, dtype="<f8").tobytes()
        else:
            for one in each:
                _write_one(data, part.kind, one)


def _write_one(data: bytearray, kind: str | Layout, value: Any) -> None:
    if not isinstance(kind, str):
        _write(data, kind, value)
    elif kind == "string":
        text = value.encode("utf-8", "replace") + b"\0"
        _write_one(data, "uint32", len(text))
        data += text
    else:
        packed = struct.pack(f"<{_NUMBERS[kind]}", value)
        data += bytes(-len(data) % len(packed))
        data += packed


def decode(layout: Layout, data: bytes) -> tuple[Any, ...]:
    """Return the value of a message.

    Raises:
        BadMessage: the bytes are no message of this type.
    """
    if len(data) > MAX_MESSAGE_BYTES:
        raise BadMessage(f"the message has {len(data)} bytes; at most {MAX_MESSAGE_BYTES} are allowed")
    if data[:4] not in (_LITTLE_ENDIAN, _BIG_ENDIAN):
        raise BadMessage("the first four bytes are not those of CDR (XCDR 1)")
    reader = _Reader(data[4:], "<" if data[:4] == _LITTLE_ENDIAN else ">")
    value = reader.structure(layout)
    if reader.left > MAX_PADDING_BYTES:
        raise BadMessage(f"{reader.left} bytes follow the last field, more than the alignment needs")
    return value


class _Reader:
    """Reader of the fields of one message."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._order, self._at = data, order, 0

    @property
    def left(self) -> int:
        """Number of bytes that are not read yet."""
        return len(self._data) - self._at

    def structure(self, layout: Layout) -> tuple[Any, ...]:
        """Return the values of the fields of a structure."""
        return tuple(self._sequence(part.kind) if part.many else self._one(part.kind) for part in layout)

    def _sequence(self, kind: str | Layout) -> list[Any]:
        count = self._one("uint32")
        if count > self.left:  # each element has at least one byte; a false length must cause no work
            raise BadMessage(f"a sequence of {count} elements does not fit into the last {self.left} bytes")
        return [self._one(kind) for _ in range(count)]

    def _one(self, kind: str | Layout) -> Any:
        if not isinstance(kind, str):
            return self.structure(kind)
        if kind == "string":
            text = self._take(self._one("uint32"))
            if not text.endswith(b"\0"):
                raise BadMessage("a string does not end with a zero byte")
            try:
                return text[:-1].decode()
            except UnicodeDecodeError:
                raise BadMessage("a string is not UTF-8") from None
        form = self._order + _NUMBERS[kind]
        self._at += -self._at % struct.calcsize(form)
        return struct.unpack(form, self._take(struct.calcsize(form)))[0]

    def _take(self, count: int) -> bytes:
        if count > self.left:
            raise BadMessage(f"{max(0, self.left)} bytes are left where {count} are needed")
        self._at += count
        return self._data[self._at - count : self._at]
