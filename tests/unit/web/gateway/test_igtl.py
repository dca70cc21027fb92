"""Bytes of OpenIGTLink messages, decoded by pyigtl and checked against the specification."""

import asyncio
import random
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyigtl.messages import CRC64, MessageBase, TransformMessage
from scipy.spatial.transform import Rotation

from station.control.clock import REAL_TIME_CLOCK
from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels
from tests.harness.gateway import ANY, DESIRED, FORCE, MEASURED, MOMENT, PAPER, Shown
from web.gateway.igtl import (
    HEADER_BYTES,
    MAX_SKIPPED_BYTES,
    BadMessage,
    IgtlServer,
    PackedMessage,
    motion_messages,
    parse_head,
    parse_target,
    state_messages,
    tracking_data,
)
from web.gateway.snapshot import SceneState, SnapshotReader, StationInfo

ROBOT = PAPER.robot()


@pytest.fixture
def ring():
    ring = Ring(len(Channels(ROBOT)))
    yield ring
    ring.close(remove=True)


def scene_of(ring: Ring, **changes: float) -> SceneState:
    feed = Shown(PAPER)
    try:
        reader = SnapshotReader(ring, ROBOT, feed.channels, REAL_TIME_CLOCK)
        row = feed.row(3)
        for group, value in changes.items():
            feed.channels.of(row, group)[:] = value
        ring.write(row)
        scene = reader.read(StationInfo(State.RUNNING, ""), with_scene=True).scene
    finally:
        feed.ring.close(remove=True)
    assert scene is not None
    return scene


def read(packed: PackedMessage) -> MessageBase:
    """Decode messages as pyigtl's client does."""
    fields = MessageBase.parse_header(packed.data[:HEADER_BYTES])
    message = MessageBase.create_message(fields["message_type"])
    assert message is not None
    message.unpack(fields, packed.data[HEADER_BYTES:])
    return message


def by_name(sent: list[PackedMessage]) -> dict[str, PackedMessage]:
    return {each.name: each for each in sent}


def test_openigtlink_transforms_are_the_tips_and_bases_in_millimetres(ring):
    scene = scene_of(ring)
    sent = by_name(motion_messages(ROBOT, scene))

    assert [name for name, each in sent.items() if each.kind == "TRANSFORM"] == [
        "TipMeasured", "TipEstimated", "TipDesired", "InnerBase", "OuterBase",
    ]  # fmt: skip
    measured = read(sent["TipMeasured"])
    assert measured.matrix[:3, 3] == pytest.approx(1e3 * np.array(MEASURED), rel=1e-6)
    assert measured.matrix[:3, :3] == pytest.approx(np.eye(3))
    assert read(sent["TipDesired"]).matrix[:3, 3] == pytest.approx(1e3 * np.array(DESIRED), rel=1e-6)
    assert measured.timestamp == pytest.approx(1e-9 * scene.stamp, abs=1e-6)
    assert scene.estimated is not None
    for name, (position, quaternion) in (("TipEstimated", scene.estimated), ("InnerBase", scene.bases[0])):
        matrix = read(sent[name]).matrix
        assert matrix[:3, 3] == pytest.approx(1e3 * np.array(position), rel=1e-5, abs=1e-4)
        assert matrix[:3, :3] == pytest.approx(Rotation.from_quat(quaternion).as_matrix(), abs=1e-6)


def test_openigtlink_centre_lines_start_at_the_bases_and_end_at_the_tip(ring):
    scene = scene_of(ring)
    sent = by_name(motion_messages(ROBOT, scene))
    body = sent["InnerLine"].data[HEADER_BYTES:]
    count, _, _, lines, line_bytes = struct.unpack("> 5I", body[:20])
    points = np.frombuffer(body, ">f4", 3 * count, 40).reshape(count, 3)
    cells = np.frombuffer(body, ">u4", line_bytes // 4, 40 + 12 * count)
    assert lines == 1
    assert cells.tolist() == [count, *range(count)]
    assert len(body) == 40 + 12 * count + line_bytes
    assert points[0] == pytest.approx(1e3 * np.array(scene.bases[0][0]), abs=1e-3)
    assert scene.estimated is not None
    assert points[-1] == pytest.approx(1e3 * np.array(scene.estimated[0]), abs=1e-3)


def test_the_openigtlink_wrench_has_its_units(ring):
    sent = by_name(motion_messages(ROBOT, scene_of(ring)))
    # The specification's unit code has a prefix of four bits, then six bits for a unit and four bits for its exponent.
    newton, metre = 0x0B << 54 | 0 << 50, 0x01 << 44
    for name, values, unit in (("TipForce", FORCE, newton), ("BaseMoment", MOMENT, newton | 1 << 50 | metre | 1 << 40)):
        count, status, told, *felt = struct.unpack("> B B Q 3d", sent[name].data[HEADER_BYTES:])
        assert (count, status, told) == (3, 0, unit)
        assert felt == list(values)


def test_stale_values_are_not_sent_by_openigtlink(ring):
    names = set(by_name(motion_messages(ROBOT, scene_of(ring, estimates_frozen=1.0))))
    assert names == {"TipEstimated", "InnerBase", "OuterBase", "InnerLine", "OuterLine"}


def test_openigtlink_state_and_cause_may_contain_any_unicode():
    sent = by_name(state_messages(StationInfo(State.HOLD, "an operator, 'Jörg', held it"), 1.0))
    assert read(sent["State"]).string == "HOLD"
    assert read(sent["Cause"]).string == "an operator, 'Jörg', held it"
    code, sub, name = struct.unpack("> H q 20s", sent["Station"].data[HEADER_BYTES : HEADER_BYTES + 30])
    assert (code, sub, name.rstrip(b"\0")) == (13, 0, b"HOLD")
    assert struct.unpack(
        "> H", state_messages(StationInfo(State.RUNNING), 1.0)[0].data[HEADER_BYTES : HEADER_BYTES + 2]
    ) == (1,)


def test_openigtlink_tracking_data_has_every_transform(ring):
    sent = motion_messages(ROBOT, scene_of(ring))
    data = tracking_data(sent, 1.0).data[HEADER_BYTES:]
    assert len(data) == 5 * 70
    name, kind, *numbers = struct.unpack("> 20s B x 12f", data[:70])
    assert (name.rstrip(b"\0"), kind) == (b"TipMeasured", 2)
    assert numbers[9:] == pytest.approx(1e3 * np.array(MEASURED), rel=1e-6)


def test_an_openigtlink_target_is_a_position_in_the_world_frame():
    for version in (1, 2):
        message = TransformMessage(np.diag([1.0, 1.0, 1.0, 1.0]), device_name="Target", timestamp=12.5)
        message.matrix[:3, 3] = (10.0, -20.0, 150.0)
        message.header_version = version
        message.metadata = {"tool": "needle"} if version == 2 else {}
        data = message.pack()
        head = parse_head(data[:HEADER_BYTES])
        assert (head.kind, head.name, head.size, head.time) == ("TRANSFORM", "Target", len(data) - HEADER_BYTES, 12.5)
        assert parse_target(head, data[HEADER_BYTES:]) == pytest.approx([0.010, -0.020, 0.150])
        assert parse_target(head._replace(name="Other"), data[HEADER_BYTES:]) is None
        with pytest.raises(BadMessage, match="check sum"):
            parse_target(head, b"\1" + data[HEADER_BYTES + 1 :])


def test_an_invalid_openigtlink_message_is_refused():
    whole = TransformMessage(device_name="Target").pack()
    short = b"\0" * 10
    http, huge = (
        b"GET / HTTP/1.1\r\n".ljust(HEADER_BYTES, b"x"),
        whole[:42] + struct.pack("> Q", 1 << 40) + whole[50:HEADER_BYTES],
    )
    for header in (http, huge, b"\xff" * HEADER_BYTES, whole[:20]):
        with pytest.raises(BadMessage):
            parse_head(header)
    with pytest.raises(BadMessage, match="10 bytes"):
        parse_target(parse_head(whole[:HEADER_BYTES])._replace(crc=CRC64(short)), short)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_openigtlink_target_that_is_not_finite_is_refused(value):
    data = TransformMessage(np.full((4, 4), value), device_name="Target").pack()
    with pytest.raises(BadMessage, match="not finite"):
        parse_target(parse_head(data[:HEADER_BYTES]), data[HEADER_BYTES:])


def test_a_wrong_extended_header_of_openigtlink_is_refused():
    random = np.random.default_rng(4)
    whole = TransformMessage(device_name="Target")
    whole.header_version = 2
    head = parse_head(whole.pack()[:HEADER_BYTES])
    for size in range(80):
        for _ in range(20):
            body = random.bytes(size)
            # The check sum is correct: an attacker can compute it.
            with pytest.raises(BadMessage):
                parse_target(head._replace(crc=CRC64(body)), body)


def message(kind: bytes, name: bytes, body: bytes, version: int = 3) -> bytes:
    """Return a message with this header, as the specification lays it out."""
    return struct.pack("> H 12s 20s I I Q Q", version, kind, name, 0, 0, len(body), CRC64(body)) + body


def target(x: float) -> bytes:
    matrix = np.eye(4)
    matrix[0, 3] = x
    return TransformMessage(matrix, device_name="Target").pack()


class Received:
    """What a server has received and logged from one client that sends `pieces` and then disconnects."""

    def __init__(self, pieces: list[bytes]) -> None:
        self.targets: list[float] = []
        self.log: list[str] = []
        self.server = IgtlServer(ROBOT, lambda position, _: self.targets.append(1e3 * position[0]), self.log.append)
        asyncio.run(self._send(pieces))

    async def _send(self, pieces: list[bytes]) -> None:
        address = await self.server.open(ANY)
        reader, writer = await asyncio.open_connection(address.host, address.port)
        for piece in pieces:
            writer.write(piece)
            await writer.drain()
            await asyncio.sleep(0)
        writer.write_eof()
        await asyncio.wait_for(_end_of(reader), 30.0)
        writer.close()
        await self.server.close()


async def _end_of(reader: asyncio.StreamReader) -> None:
    try:
        while await reader.read(65536):
            pass
    except ConnectionResetError:
        return


def pieces_of(data: bytes, seed: int, longest: int) -> list[bytes]:
    lengths, pieces = random.Random(seed), []
    while data:
        count = lengths.randint(1, longest)
        pieces.append(data[:count])
        data = data[count:]
    return pieces


def test_a_target_after_a_long_image_is_used():
    image = message(b"IMAGE", "Schädel".encode("latin-1"), random.Random(1).randbytes(300_000))
    received = Received(pieces_of(target(1.0) + image + target(2.0) + image + target(3.0), 5, 9000))
    assert received.targets == pytest.approx([1.0, 2.0, 3.0])
    assert received.server.skipped == {"IMAGE": 2}
    assert received.log == ["OpenIGTLink: messages of type 'IMAGE' are skipped, the station does not use them: 1"]


def test_a_skipped_openigtlink_message_is_not_kept_in_memory():
    block = bytes(1 << 16)
    header = struct.pack("> H 12s 20s I I Q Q", 2, b"IMAGE", b"Volume", 0, 0, 512 * len(block), 0)
    tracemalloc.start()
    try:
        received = Received([header, *[block] * 512, target(4.0)])
        assert tracemalloc.get_traced_memory()[1] < 4_000_000  # the message has 34 MB
    finally:
        tracemalloc.stop()
    assert received.targets == pytest.approx([4.0])


def test_a_disconnected_openigtlink_client_has_its_reason_in_the_log():
    for kind, name, size, reason in (
        (b"IMAGE", b"Slice", MAX_SKIPPED_BYTES + 1, "'IMAGE' announces 1073741825 bytes; at most 1073741824"),
        (b"TRANSFORM", b"Target", 70_000, "'TRANSFORM' announces 70000 bytes; at most 65536"),
    ):
        received = Received([struct.pack("> H 12s 20s I I Q Q", 2, kind, name, 0, 0, size, 0)])
        assert received.log == [f"OpenIGTLink: a client is disconnected: a message {reason}"]


def test_an_openigtlink_request_with_other_characters_is_answered():
    header = message(b"GET_\xe9\xff", b"\xe9" * 20, b"")
    received = Received([header, target(5.0)])
    assert received.targets == pytest.approx([5.0])
    assert received.log == []


@settings(max_examples=60, deadline=None)
@given(
    sent=st.lists(st.tuples(st.binary(max_size=12), st.binary(max_size=20), st.integers(0, 200_000)), max_size=5),
    version=st.integers(1, 3), seed=st.integers(0, 1000), longest=st.integers(500, 100_000),
)  # fmt: skip
def test_a_target_after_any_openigtlink_messages_is_used(sent, version, seed, longest):
    others = [each for each in sent if each[0][:3] not in (b"GET", b"STT", b"STP")]
    data = b"".join(message(kind, name, bytes(size), version) for kind, name, size in others)
    received = Received(pieces_of(data + target(6.0), seed, longest))
    assert received.targets == pytest.approx([6.0])
    assert received.server.skipped.total() == len(others)
