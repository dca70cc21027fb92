"""Frames of CANopen equal the examples of CiA 301 and of the Lawicel protocol, computed by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.devices.cia402.protocol import (
    CanError,
    Frame,
    FrameReader,
    SdoReply,
    abort_text,
    decode,
    download,
    emergency_text,
    encode,
    sdo_reply,
    signed,
    upload,
)


def test_frame_is_a_line_of_hexadecimal_digits():
    # Identifier 0x205, 6 bytes: controlword 0x000F and velocity -2, least significant byte first.
    assert encode(Frame(0x205, b"\x0f\x00\xfe\xff\xff\xff")) == b"t20560F00FEFFFFFF\r"
    assert encode(Frame(0x080, b"")) == b"t0800\r"


def test_frame_of_eight_bytes_takes_at_most_135_bits():
    assert Frame(0x181, bytes(8)).duration == pytest.approx(135e-6)


@pytest.mark.parametrize("line", [b"t2056", b"t20511", b"t2059" + b"00" * 9, b"T2050", b"t8001FF", b"tG801FF", b""])
def test_damaged_line_is_no_frame(line):
    assert decode(line) is None


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.integers(1, 20))
def test_reader_finds_frames_in_pieces_of_any_size(identifier, data, size):
    frame, reader = Frame(identifier, data), FrameReader()
    stream = b"z\r" + encode(frame) + b"\a" + encode(frame)
    found = [each for at in range(0, len(stream), size) for each in reader.feed(stream[at : at + size])]
    assert found == [frame, frame]
    assert reader.dropped.count == 0


def test_reader_counts_the_bytes_of_damaged_lines():
    reader = FrameReader()
    assert reader.feed(b"t0x80\rt0800\r") == [Frame(0x080, b"")]
    assert reader.dropped.count == 6


def test_sdo_requests_have_the_command_bytes_of_cia_301():
    assert upload(5, (0x6041, 0)) == Frame(0x605, b"\x40\x41\x60\x00\x00\x00\x00\x00")
    assert download(5, (0x6060, 0), 3, 1) == Frame(0x605, b"\x2f\x60\x60\x00\x03\x00\x00\x00")
    assert download(5, (0x6040, 0), 0x0F, 2) == Frame(0x605, b"\x2b\x40\x60\x00\x0f\x00\x00\x00")
    assert download(5, (0x607D, 1), -2, 4) == Frame(0x605, b"\x23\x7d\x60\x01\xfe\xff\xff\xff")


@pytest.mark.parametrize(("value", "size"), [(256, 1), (-129, 1), (1 << 16, 2), (1 << 32, 4), (-(1 << 31) - 1, 4)])
def test_value_that_does_not_fit_is_refused(value, size):
    with pytest.raises(CanError, match=f"object 0x6060:00 = {value} does not fit into {size} bytes"):
        download(5, (0x6060, 0), value, size)


def test_sdo_replies_are_read_by_their_size():
    assert sdo_reply(b"\x4f\x61\x60\x00\x03\xff\xff\xff") == SdoReply((0x6061, 0), 3, True)
    assert sdo_reply(b"\x4b\x41\x60\x00\x37\x02\xff\xff") == SdoReply((0x6041, 0), 0x237, True)
    assert sdo_reply(b"\x43\x64\x60\x00\xfe\xff\xff\xff") == SdoReply((0x6064, 0), 0xFFFFFFFE, True)
    assert sdo_reply(b"\x60\x40\x60\x00\x00\x00\x00\x00") == SdoReply((0x6040, 0), 0, True)
    assert sdo_reply(b"\x80\x40\x60\x00\x00\x00\x02\x06") == SdoReply((0x6040, 0), 0x06020000, False)
    assert sdo_reply(b"\x41\x64\x60\x00\x08\x00\x00\x00") is None  # not expedited
    assert sdo_reply(b"\x60\x40\x60") is None


def test_signed_values():
    assert [signed(0xFFFFFFFE), signed(0x7FFFFFFF), signed(0xFF, 1), signed(0x8000, 2)] == [-2, 2**31 - 1, -1, -32768]


def test_error_codes_have_the_makers_meaning_or_that_of_their_group():
    assert emergency_text(0x8611) == "the position does not follow its command (error 0x8611)"
    assert emergency_text(0x2311) == "the current is wrong (error 0x2311)"
    assert emergency_text(0xABCD) == "a drive's own error (error 0xABCD)"
    assert abort_text(0x06020000) == "the object does not exist (abort 0x06020000)"
    assert abort_text(0x12345678) == "rejected (abort 0x12345678)"


def test_reader_recovers_after_lines_that_seem_to_have_a_time():
    """Three lines whose length was damaged look like lines with a time behind the frame; one more frame is lost."""
    reader, frame = FrameReader(), Frame(0x181, bytes(range(6)))
    damaged = b"t1814" + encode(frame)[5:]
    assert reader.feed(3 * damaged) == []
    assert reader.feed(3 * encode(frame)) == 2 * [frame]
