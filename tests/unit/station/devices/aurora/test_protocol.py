"""Parser of the Aurora's Combined API: CRCs, captured replies, and documented replies that arrive in pieces."""

import itertools
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.devices.aurora.protocol import (
    AuroraError,
    ReplyReader,
    ToolFrame,
    ToolState,
    binary,
    crc16,
    error_code,
    error_words,
    framed,
    parse_bx,
    parse_phinf,
    parse_phsr,
    parse_tx,
    system_words,
)

CHECKS = {
    "INIT:": 0xE3A5,
    "OKAY": 0xA896,
    "RESET": 0xBE6F,
    "VER:0": 0x65EE,
    "TSTART:": 0x5423,
    "TSTOP:": 0x2C14,
    "PHSR:00": 0x20FF,
    "PHSR:02": 0xE17E,
    "BX:0801": 0x00EC,
    "BX:0001": 0xC26D,
    "TX:0801": 0xC19B,
    "TX:0001": 0x031A,
    "COMM:50000": 0x0048,
    "ERROR01": 0x6BC2,
    "ERROR0C": 0x4E42,
    "PINIT:0A": 0xD5EB,
    "PENA:0AD": 0xAD1E,
    "010A001": 0xC1B5,
    "GETINFO:Features.Firmware.Version": 0x0492,
}
#: Captured replies of one tool: at (10, -20.5, -150.25) mm, and with the tool missing.
VALID = bytes.fromhex(
    "c4a52d003043 010a01 0000803f000000000000000000000000 000020410000a4c1004016c3 6de7fb3d 31000000 00000000 0000 1f37"
)
MISSING = bytes.fromhex("c4a50d002983 010a02 31010000 00000000 0000 4d8b")
TX = b"010A+10000+00000+00000+00000+001000-002050-015025+012300000003100000000\n0000FEE1\r"
STREAM = b"OKAYA896\r" + VALID + b"ERROR0C4E42\r" + TX + MISSING + b"RESETBE6F\r"
REPLIES = ["OKAY", VALID[6:-2], "ERROR0C", TX[:-5].decode(), MISSING[6:-2], "RESET"]


@pytest.mark.parametrize(("text", "crc"), CHECKS.items())
def test_crc_matches_the_examples_of_the_protocol(text, crc):
    assert crc16(text.encode()) == crc
    assert framed(text) == f"{text}{crc:04X}\r".encode()


def test_crc_has_the_check_value_of_the_catalogue():
    assert crc16(b"123456789") == 0xBB3D  # CRC-16/ARC


@pytest.mark.parametrize("capture", [VALID, MISSING])
def test_binary_reply_is_framed_like_the_capture(capture):
    assert binary(capture[6:-2]) == capture


def test_captured_bx_reply_is_parsed():
    reply = parse_bx(VALID[6:-2])
    (tool,) = reply.tools

    assert (tool.handle, tool.state, tool.port_status, tool.frame) == (0x0A, ToolState.VALID, 0x31, 0)
    assert tool.transform is not None
    assert tool.transform.quaternion == (1.0, 0.0, 0.0, 0.0)
    assert tool.transform.position == (10.0, -20.5, -150.25)
    assert tool.transform.error == pytest.approx(0.123)
    assert reply.system_status == 0


def test_captured_reply_with_a_missing_tool_is_parsed():
    (tool,) = parse_bx(MISSING[6:-2]).tools

    assert (tool.state, tool.transform, tool.port_status, tool.frame) == (ToolState.MISSING, None, 0x131, 0)


def test_captured_tx_reply_equals_the_bx_reply():
    (tool,) = parse_tx(TX[:-5].decode()).tools

    assert (tool.handle, tool.state, tool.port_status, tool.frame) == (0x0A, ToolState.VALID, 0x31, 0)
    assert tool.transform is not None
    assert tool.transform.position == (10.0, -20.5, -150.25)
    assert tool.transform.error == pytest.approx(0.123)


def test_tx_handles_without_a_measurement_have_no_transform():
    reply = parse_tx("030AMISSING000000310000002A\n0BDISABLED000000010000002B\n0CUNOCCUPIED\n0041")

    assert [tool.state for tool in reply.tools] == [ToolState.MISSING, ToolState.DISABLED, ToolState.UNOCCUPIED]
    assert [tool.frame for tool in reply.tools] == [42, 43, None]
    assert all(tool.transform is None for tool in reply.tools)
    assert reply.system_status == 0x41


def test_disabled_tx_handle_may_lack_status_and_frame():
    """The reply is given byte by byte with its CRC; ndicapi's `ndiTXHelper` ends such an entry at the line's end."""
    entries = "020BDISABLED\n0A+10000+00000+00000+00000+001000-002050-015025+012300000003100000007\n0000"
    (text,) = ReplyReader().feed(framed(entries))
    assert isinstance(text, str)

    disabled, valid = parse_tx(text).tools

    assert disabled == ToolFrame(0x0B, ToolState.DISABLED, None, 0, None)
    assert (valid.handle, valid.state, valid.frame) == (0x0A, ToolState.VALID, 7)


def test_disabled_bx_handle_has_neither_status_nor_frame():
    reply = parse_bx(bytes([2, 0x0B, 4]) + VALID[7:-4] + bytes([0x40, 0]))

    assert [tool.state for tool in reply.tools] == [ToolState.DISABLED, ToolState.VALID]
    assert reply.system_status == 0x40


def changed(at: int, value: bytes) -> bytes:
    """Return the captured BX body with other bytes at `at`."""
    body = VALID[6:-2]
    return body[:at] + value + body[at + len(value) :]


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        (b"", "ends early"),
        (VALID[6:-3], "ends early"),
        (VALID[6:-2] + b"\0", "longer than"),
        (changed(2, b"\x03"), "status 03"),
        (changed(3, struct.pack("<f", float("nan"))), "not finite"),
        (changed(3, struct.pack("<f", 0.5)), "norm 0.5"),
        (changed(19, struct.pack("<f", float("inf"))), "not finite"),
        (changed(23, struct.pack("<f", 1e5)), "y = 100000 mm is beyond 9999.99 mm"),
        (changed(31, struct.pack("<f", -1.0)), "error -1"),
    ],
)
def test_impossible_bx_body_is_refused_by_name(body, complaint):
    with pytest.raises(AuroraError, match=complaint):
        parse_bx(body)


@pytest.mark.parametrize(
    "text",
    ["", "0", "01", "010A", TX[:-6].decode(), TX[:-5].decode() + "0", "020AMISSING000000310000002A\n0000", "OKAY"],
)
def test_malformed_tx_reply_is_refused(text):
    with pytest.raises(AuroraError):
        parse_tx(text)


def test_port_handles_are_parsed():
    assert parse_phsr("00") == []
    assert parse_phsr("010A001") == [(0x0A, 0x001)]
    assert parse_phsr("020A0310B001") == [(0x0A, 0x031), (0x0B, 0x001)]
    with pytest.raises(AuroraError, match="for 2 handles"):
        parse_phsr("020A001")


def test_identity_of_a_tool_is_parsed():
    identity = parse_phinf("02000000" + "NDI         " + "001" + "3A5C1D00" + "31")

    assert identity == ("02000000", "NDI", "001", "3A5C1D00", 0x31, None, None)
    placed = parse_phinf("02000000" + "NDI         " + "001" + "3A5C1D00" + "31" + "00000000" + "10" + "12" + "01")
    assert placed == ("02000000", "NDI", "001", "3A5C1D00", 0x31, 12, 1)
    assert parse_phinf("UNOCCUPIED") is None
    with pytest.raises(AuroraError, match="32 characters, not 33 or 47"):
        parse_phinf("x" * 32)


def test_error_codes_have_texts():
    assert error_code("ERROR0C") == 0x0C
    assert error_code("OKAY") is None
    assert error_words(0x0C) == "not in this mode (ERROR0C)"
    assert error_words(0x77) == "unknown error (ERROR77)"
    assert system_words(0x12) == "interference from outside, hardware failure"


def feed(parts: list[bytes]) -> tuple[list[str | bytes], ReplyReader]:
    reader = ReplyReader()
    return [reply for part in parts for reply in reader.feed(part)], reader


@given(st.lists(st.integers(0, len(STREAM))))
def test_replies_do_not_depend_on_the_split_of_the_stream(cuts):
    positions = [0, *sorted(cuts), len(STREAM)]
    replies, reader = feed([STREAM[a:b] for a, b in itertools.pairwise(positions)])

    assert replies == REPLIES
    assert (reader.noise, reader.crc_errors) == (0, 0)


@pytest.mark.parametrize("capture", [VALID, MISSING, TX, b"OKAYA896\r"])
def test_every_single_flipped_bit_is_detected(capture):
    for bit in range(8 * len(capture)):
        spoilt = bytearray(capture)
        spoilt[bit // 8] ^= 1 << bit % 8
        replies, _ = feed([bytes(spoilt), b"\r"])
        assert replies == []


@pytest.mark.parametrize("capture", [VALID, MISSING, TX, b"OKAYA896\r"])
def test_lost_byte_affects_at_most_its_reply_and_the_next(capture):
    for lost in range(len(capture)):
        replies, reader = feed([capture[:lost] + capture[lost + 1 :], VALID, VALID])
        assert replies in ([VALID[6:-2]] * 2, [VALID[6:-2]])
        assert reader.noise > 0


def test_endless_text_is_discarded():
    reader = ReplyReader()
    reader.feed(b"A" * 5000)

    assert reader.noise == 5000
    assert reader.feed(b"OKAYA896\r") == ["OKAY"]


def test_impossible_length_of_a_reply_is_rejected_at_once():
    header = b"\xc4\xa5" + struct.pack("<H", 60000)
    replies, _ = feed([header + struct.pack("<H", crc16(header)), VALID])

    assert replies == [VALID[6:-2]]
