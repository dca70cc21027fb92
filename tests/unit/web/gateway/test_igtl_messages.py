"""OpenIGTLink bytes, read by pyigtl and by hand from the specification."""

import struct

import numpy as np
import pytest
from pyigtl.messages import CRC64, MessageBase, TransformMessage
from scipy.spatial.transform import Rotation

from station.control.clock import REAL_TIME
from station.control.ring import Ring
from station.control.states import State
from station.control.telemetry import Channels
from tests.harness.gateway import DESIRED, FORCE, MEASURED, MOMENT, PAPER, Shown
from web.gateway.igtl.messages import HEADER, BadMessage, Packed, head_of, moving, standing, target_of, tracking_data
from web.gateway.seen import Eyes, Seen, Told

ROBOT = PAPER.robot()


@pytest.fixture
def ring():
    ring = Ring(len(Channels(ROBOT)))
    yield ring
    ring.close(remove=True)


def seen_of(ring: Ring, **changes: float) -> Seen:
    feed = Shown(PAPER)
    try:
        eyes = Eyes(ring, ROBOT, feed.channels, REAL_TIME)
        row = feed.row(3)
        for group, value in changes.items():
            feed.channels.of(row, group)[:] = value
        ring.write(row)
        seen = eyes.look(Told(State.RUNNING, ""), wanted=True).seen
    finally:
        feed.ring.close(remove=True)
    assert seen is not None
    return seen


def read(packed: Packed) -> MessageBase:
    """As pyigtl's client does."""
    fields = MessageBase.parse_header(packed.data[:HEADER])
    message = MessageBase.create_message(fields["message_type"])
    assert message is not None
    message.unpack(fields, packed.data[HEADER:])
    return message


def by_name(sent: list[Packed]) -> dict[str, Packed]:
    return {each.name: each for each in sent}


def test_transforms_are_the_tips_and_bases_in_millimetres(ring):
    seen = seen_of(ring)
    sent = by_name(moving(ROBOT, seen))

    assert [name for name, each in sent.items() if each.kind == "TRANSFORM"] == [
        "TipMeasured", "TipEstimated", "TipDesired", "InnerBase", "OuterBase",
    ]  # fmt: skip
    measured = read(sent["TipMeasured"])
    assert measured.matrix[:3, 3] == pytest.approx(1e3 * np.array(MEASURED), rel=1e-6)
    assert measured.matrix[:3, :3] == pytest.approx(np.eye(3))
    assert read(sent["TipDesired"]).matrix[:3, 3] == pytest.approx(1e3 * np.array(DESIRED), rel=1e-6)
    assert measured.timestamp == pytest.approx(1e-9 * seen.stamp, abs=1e-6)
    assert seen.estimated is not None
    for name, (position, quaternion) in (("TipEstimated", seen.estimated), ("InnerBase", seen.bases[0])):
        matrix = read(sent[name]).matrix
        assert matrix[:3, 3] == pytest.approx(1e3 * np.array(position), rel=1e-5, abs=1e-4)
        assert matrix[:3, :3] == pytest.approx(Rotation.from_quat(quaternion).as_matrix(), abs=1e-6)


def test_centre_lines_begin_at_the_bases_and_end_at_the_tip(ring):
    seen = seen_of(ring)
    sent = by_name(moving(ROBOT, seen))
    body = sent["InnerLine"].data[HEADER:]
    count, _, _, lines, line_bytes = struct.unpack("> 5I", body[:20])
    points = np.frombuffer(body, ">f4", 3 * count, 40).reshape(count, 3)
    cells = np.frombuffer(body, ">u4", line_bytes // 4, 40 + 12 * count)
    assert lines == 1
    assert cells.tolist() == [count, *range(count)]
    assert len(body) == 40 + 12 * count + line_bytes
    assert points[0] == pytest.approx(1e3 * np.array(seen.bases[0][0]), abs=1e-3)
    assert seen.estimated is not None
    assert points[-1] == pytest.approx(1e3 * np.array(seen.estimated[0]), abs=1e-3)


def test_the_wrench_has_its_units(ring):
    sent = by_name(moving(ROBOT, seen_of(ring)))
    # Units by the specification: six bits a unit, four an exponent, after a prefix of four.
    newton, metre = 0x0B << 54 | 0 << 50, 0x01 << 44
    for name, values, unit in (("TipForce", FORCE, newton), ("BaseMoment", MOMENT, newton | 1 << 50 | metre | 1 << 40)):
        count, status, told, *felt = struct.unpack("> B B Q 3d", sent[name].data[HEADER:])
        assert (count, status, told) == (3, 0, unit)
        assert felt == list(values)


def test_what_is_old_is_not_sent_as_if_it_were_of_now(ring):
    names = set(by_name(moving(ROBOT, seen_of(ring, held=1.0))))
    assert names == {"TipEstimated", "InnerBase", "OuterBase", "InnerLine", "OuterLine"}


def test_state_and_cause_in_any_letters():
    sent = by_name(standing(Told(State.HOLD, "an operator, 'Jörg', held it"), 1.0))
    assert read(sent["State"]).string == "HOLD"
    assert read(sent["Cause"]).string == "an operator, 'Jörg', held it"
    code, sub, name = struct.unpack("> H q 20s", sent["Station"].data[HEADER : HEADER + 30])
    assert (code, sub, name.rstrip(b"\0")) == (13, 0, b"HOLD")
    assert struct.unpack("> H", standing(Told(State.RUNNING), 1.0)[0].data[HEADER : HEADER + 2]) == (1,)


def test_tracking_data_has_every_transform(ring):
    sent = moving(ROBOT, seen_of(ring))
    data = tracking_data(sent, 1.0).data[HEADER:]
    assert len(data) == 5 * 70
    name, kind, *numbers = struct.unpack("> 20s B x 12f", data[:70])
    assert (name.rstrip(b"\0"), kind) == (b"TipMeasured", 2)
    assert numbers[9:] == pytest.approx(1e3 * np.array(MEASURED), rel=1e-6)


def test_a_target_is_a_place_in_the_world():
    for version in (1, 2):
        message = TransformMessage(np.diag([1.0, 1.0, 1.0, 1.0]), device_name="Target", timestamp=12.5)
        message.matrix[:3, 3] = (10.0, -20.0, 150.0)
        message.header_version = version
        message.metadata = {"tool": "needle"} if version == 2 else {}
        data = message.pack()
        head = head_of(data[:HEADER])
        assert (head.kind, head.name, head.size, head.time) == ("TRANSFORM", "Target", len(data) - HEADER, 12.5)
        assert target_of(head, data[HEADER:]) == pytest.approx([0.010, -0.020, 0.150])
        assert target_of(head._replace(name="Other"), data[HEADER:]) is None
        with pytest.raises(BadMessage, match="check sum"):
            target_of(head, b"\1" + data[HEADER + 1 :])


def test_what_is_no_message_is_refused():
    whole = TransformMessage(device_name="Target").pack()
    short = b"\0" * 10
    http, huge = b"GET / HTTP/1.1\r\n".ljust(HEADER, b"x"), whole[:42] + struct.pack("> Q", 1 << 40) + whole[50:HEADER]
    for header in (http, huge, b"\xff" * HEADER, whole[:20]):
        with pytest.raises(BadMessage):
            head_of(header)
    with pytest.raises(BadMessage, match="10 bytes"):
        target_of(head_of(whole[:HEADER])._replace(crc=CRC64(short)), short)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_target_that_is_nowhere_is_refused(value):
    data = TransformMessage(np.full((4, 4), value), device_name="Target").pack()
    with pytest.raises(BadMessage, match="nowhere"):
        target_of(head_of(data[:HEADER]), data[HEADER:])


def test_what_lies_about_its_extended_header_is_refused():
    random = np.random.default_rng(4)
    whole = TransformMessage(device_name="Target")
    whole.header_version = 2
    head = head_of(whole.pack()[:HEADER])
    for size in range(80):
        for _ in range(20):
            body = random.bytes(size)
            # Its check sum is right: whoever wants to harm us can add up.
            with pytest.raises(BadMessage):
                target_of(head._replace(crc=CRC64(body)), body)
