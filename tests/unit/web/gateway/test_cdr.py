"""CDR encoding and type hashes agree with rosbags, an independent implementation."""

import contextlib
import random
from dataclasses import fields

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.harness import crtk_peer
from web.gateway import ros_types
from web.gateway.cdr import MAX_MESSAGE_BYTES, BadMessage, blank, decode
from web.gateway.ros_types import COMMAND, DEFINITIONS, JOINT_STATE, POSE, STRING, RosService, RosType

STORE = get_typestore(Stores.ROS2_JAZZY)
#: The definitions of `crtk_msgs` as published.
PUBLISHED = {
    "crtk_msgs/msg/OperatingState": "std_msgs/Header header\nstring          state\nbool            is_homed\n"
    "bool            is_busy\n",
    "crtk_msgs/msg/StringStamped": "std_msgs/Header header\nstring\t        string\n",
}
for name, text in PUBLISHED.items():
    STORE.register(get_types_from_msg(text, name))
KINDS = [each for each in vars(ros_types).values() if isinstance(each, RosType)]
SERVICES = [each for each in vars(ros_types).values() if isinstance(each, RosService)]
NUMBERS = {"bool": [True, False], "uint8": [0, 255], "int32": [-7, 2**31 - 1], "uint32": [0, 2**32 - 1]}


def some(layout, rng):
    """Return a random value of a type."""

    def one(kind):
        if not isinstance(kind, str):
            return some(kind, rng)
        if kind == "string":
            return rng.choice(["", "a", "tip", "Röhre", "x" * 37])
        return rng.choice(NUMBERS[kind]) if kind in NUMBERS else float(np.float32(rng.uniform(-9.0, 9.0)))

    return tuple([one(part.kind) for _ in range(rng.randrange(4))] if part.many else one(part.kind) for part in layout)


def plain(value):
    """Return a message of rosbags, or a decoded value, as nested lists."""
    if hasattr(value, "__dataclass_fields__"):
        return [
            plain(getattr(value, field.name))
            for field in fields(value)
            if field.name.islower() and field.name[0] != "_"
        ]
    return [plain(each) for each in value] if isinstance(value, tuple | list | np.ndarray) else value


def own_hash(kind: RosType) -> str:
    """Return the hash that rosbags computes from this project's definitions, with the packages of ROS."""
    packages = {name.rpartition("/")[2]: name.replace("/msg/", "/") for name in STORE.types}

    def text(name):
        lines = [line.split() for line in DEFINITIONS[name].splitlines()]
        return "\n".join(f"{known(each)} {field}" for each, field in lines)

    def known(each):
        base = each.removesuffix("[]")
        return packages.get(base, base) + each[len(base) :]

    own = get_typestore(Stores.EMPTY)
    for name in [name for name in DEFINITIONS if not name.endswith(("_Request", "_Response"))]:
        own.register(get_types_from_msg(text(name), packages[name].replace("/", "/msg/")))
    return own.hash_rihs01(kind.name)


def test_services_have_the_hashes_of_ros_2():
    # The value of ROS 2 Jazzy, which shows that the other values are computed by the rules of ROS 2.
    known = "RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a"
    assert crtk_peer.STORE.hash_rihs01("std_srvs/srv/SetBool") == known
    for each in SERVICES:
        assert each.kind.hash == crtk_peer.STORE.hash_rihs01(each.kind.name)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_type_has_the_definition_and_the_hash_of_ros_2(kind):
    assert kind.hash == STORE.hash_rihs01(kind.name)
    assert own_hash(kind) == kind.hash


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
@pytest.mark.parametrize("seed", range(20))
def test_rosbags_reads_and_writes_the_same_bytes(kind, seed):
    value = some(kind.layout, random.Random(seed))
    data = kind.encode(*value)
    read = STORE.deserialize_cdr(data, kind.name)
    assert plain(read) == plain(value)
    assert bytes(STORE.serialize_cdr(read, kind.name)) == data
    for little in (True, False):
        assert plain(kind.decode(bytes(STORE.serialize_cdr(read, kind.name, little_endian=little)))) == plain(value)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_damaged_bytes_are_refused_or_read_but_never_raise_another_error(kind):
    rng = random.Random(1)
    for _ in range(300):
        data = bytearray(kind.encode(*some(kind.layout, rng)))
        for _ in range(rng.randrange(1, 6)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        del data[rng.randrange(len(data)) :]
        with contextlib.suppress(BadMessage):
            kind.decode(bytes(data))


@pytest.mark.parametrize(
    ("kind", "data", "reason"),
    [
        (STRING, b"", "first four bytes"),
        (STRING, b"\0\x07\0\0", "first four bytes"),
        (STRING, b"\0\1\0\0\xff\xff\xff\xff", "are left where"),
        (STRING, b"\0\1\0\0\2\0\0\0ab", "does not end with a zero byte"),
        (STRING, b"\0\1\0\0\2\0\0\0\xff\0", "UTF-8"),
        (STRING, STRING.encode("a") + bytes(4), "follow the last field"),
        (JOINT_STATE, JOINT_STATE.encode(*blank(JOINT_STATE.layout))[:-16] + b"\xff" * 16, "elements"),
        (POSE, POSE.encode(*blank(POSE.layout))[:-1], "are left where"),
        (COMMAND, bytes(MAX_MESSAGE_BYTES + 1), "at most"),
    ],
)
def test_a_message_is_refused_with_the_reason(kind, data, reason):
    with pytest.raises(BadMessage, match=reason):
        decode(kind.layout, data)
