"""Lines of the Zaber ASCII protocol; the checksums of the examples were computed by hand."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.devices.zaber_ascii.protocol import (
    FLAGS,
    Alert,
    LineReader,
    Reply,
    ZaberAsciiError,
    checksum,
    decode,
    encode,
    flag_text,
    reason_text,
    speed_data,
)


def test_command_carries_address_id_and_checksum():
    # "01 1 23 stop ": 48+49+32 + 49+32 + 50+51+32 + 115+116+111+112+32 = 829; 829 mod 256 = 61; 256 - 61 = 195 = C3.
    assert encode(1, 1, 23, "stop") == b"/01 1 23 stop :C3\n"


def test_checksum_makes_the_sum_of_all_bytes_a_multiple_of_256():
    # "01 0 00 OK IDLE -- 0": 48+49+32+48+32+48+48+32+79+75+32+73+68+76+69+32+45+45+32+48 = 1011; 1024 - 1011 = 13.
    assert checksum(b"01 0 00 OK IDLE -- 0") == 13


def test_speed_is_converted_by_the_manufacturers_factor():
    # The T-series stage T-LSR300B has microsteps of 0.49609375 um: 20 mm/s * 1.6384 / 0.49609375 um = 66052.
    assert speed_data(0.020 / 0.49609375e-6) == 66052
    with pytest.raises(ZaberAsciiError, match="not finite"):
        speed_data(float("nan"))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"@01 0 00 OK IDLE -- 0:0D", Reply(1, 0, 0, True, False, "--", "0")),
        (b"@03 1 23 OK BUSY NI -1250", Reply(3, 1, 23, True, True, "NI", "-1250")),
        (b"@02 1 RJ IDLE WR BADDATA", Reply(2, 1, None, False, False, "WR", "BADDATA")),
        (b"@01 1 00 OK IDLE -- 02 WR FS", Reply(1, 1, 0, True, False, "--", "02 WR FS")),
        (b"!01 1 IDLE FS", Alert(1, 1, False, "FS")),
        (b"#01 0 a comment of the device", None),
        (b"@01 0 00 OK IDLE -- 0:0E", None),  # wrong checksum
        (b"@1 0 00 OK IDLE -- 0", None),
        (b"@01 0 00 OK SLEEPING -- 0", None),
        (b"", None),
    ],
)
def test_line_is_decoded_or_dropped(line, message):
    assert decode(line, checked=False) == message


def test_lines_without_checksum_are_dropped_once_the_devices_send_checksums():
    reader = LineReader()
    assert len(reader.feed(b"@01 0 00 OK IDLE -- 0\r\n")) == 1
    reader.checked = True
    assert reader.feed(b"@01 0 00 OK IDLE -- 0\r\n") == []
    assert len(reader.feed(b"@01 0 00 OK IDLE -- 0:0D\r\n")) == 1
    assert reader.dropped.count == 21


@given(cuts=st.lists(st.integers(0, 60), max_size=6))
def test_stream_may_be_split_anywhere(cuts):
    data, reader = b"@01 0 00 OK IDLE -- 0:0D\r\n!01 1 IDLE FS\n@03 1 23 OK BUSY NI -7\r\n", LineReader()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    found = [m for a, b in pairwise(edges) for m in reader.feed(data[a:b])]
    assert [type(message) for message in found] == [Reply, Alert, Reply]


def test_message_after_a_lost_line_end_is_read():
    assert LineReader().feed(b"@01 0 00 OK IDLE -@01 0 00 OK IDLE -- 0:0D\n") == [
        Reply(1, 0, 0, True, False, "--", "0")
    ]


def test_endless_line_is_dropped_as_noise():
    reader = LineReader()
    for _ in range(100):
        assert reader.feed(b"x" * 50) == []
    assert reader.dropped.count > 4000
    assert len(reader._rest) <= 256


@given(st.binary(max_size=300))
def test_noise_raises_nothing(data):
    LineReader().feed(data)


@given(index=st.integers(0, 23), bit=st.integers(0, 7))
def test_no_flipped_bit_of_a_checked_line_changes_its_meaning(index, bit):
    line = bytearray(b"@01 1 42 OK BUSY -- 90210")
    line += b":%02X" % checksum(bytes(line[1:]))
    good = decode(bytes(line), checked=True)
    line[index + 1] ^= 1 << bit
    assert decode(bytes(line), checked=True) in (None, good)


def test_command_that_lost_its_colon_is_no_other_number():
    words = encode(1, 1, 5, "move vel 1234").decode().replace(":", "").split()
    assert words[:-1] == ["/01", "1", "05", "move", "vel", "1234"]  # the checksum is a separate word


def test_flags_and_reasons_have_a_meaning():
    assert flag_text("FS") == "the motor stalled and has stopped (flag FS)"
    assert flag_text("QQ") == "a flag that the manual does not list (flag QQ)"
    assert reason_text("BADDATA") == "the value is out of range (BADDATA)"
    assert {"FD", "FS", "FQ", "WR", "WH", "NC", "NI"} <= set(FLAGS)
