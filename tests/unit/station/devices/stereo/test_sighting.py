"""Datagrams of the ball's pixels: round trip, and damaged ones."""

import math

from hypothesis import given
from hypothesis import strategies as st

from station.devices.stereo.sighting import Sighting, pack, unpack

FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64)


@given(st.integers(0, 2**64 - 1), FINITE, FINITE, FINITE, FINITE)
def test_sighting_survives_its_datagram(frame: int, exposed: float, sent: float, column: float, row: float) -> None:
    sighting = Sighting("left-2", frame, exposed, sent, column, row)

    assert unpack(pack(sighting)) == sighting


def test_frame_without_a_ball_is_not_visible() -> None:
    found = unpack(pack(Sighting("left", 1, 2.0, 3.0, math.nan, math.nan)))

    assert found is not None
    assert not found.visible


@given(st.binary(max_size=200))
def test_any_other_bytes_are_refused(data: bytes) -> None:
    assert unpack(data) is None


@given(st.data())
def test_damaged_datagram_gives_no_pixel_that_is_not_a_number(data: st.DataObject) -> None:
    whole = bytearray(pack(Sighting("left", 7, 1.0, 1.1, 640.0, 360.0)))
    for _ in range(data.draw(st.integers(1, 8))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))

    found = unpack(bytes(whole))

    if found is not None:
        assert math.isfinite(found.exposed + found.sent)
        assert math.isfinite(found.column) == math.isfinite(found.row) == found.visible
