"""The overlay of a camera's picture uses the telemetry at the time of the picture's exposure."""

from collections.abc import Iterator

import numpy as np
import pytest

from station.config.controllers import PERIOD_S
from station.control.ring import HEARTBEAT, RING_ROWS, Ring
from station.devices.cameras import CameraFile
from station.service.camera_overlay import NO_CALIBRATION, overlay, rows_at
from station.service.station_file import load_station
from station.service.supervisor import Supervisor

WIDTH = 3


@pytest.fixture
def ring() -> Iterator[Ring]:
    """Return a ring whose rows have their number in the first channel; the last one was written at 100 s."""
    ring = Ring(WIDTH)
    for number in range(6000):
        ring.write(np.array([number, 0.0, 0.0]))
    ring.numbers[HEARTBEAT] = 100.0
    yield ring
    ring.close(remove=True)


@pytest.mark.parametrize("age", [0.06, 0.2, 1.0, 4.0])
def test_middle_row_is_at_the_time_of_the_exposure(ring: Ring, age: float) -> None:
    rows = rows_at(ring, 100.0 - age)

    assert len(rows) % 2 == 1
    assert rows[len(rows) // 2, 0] == 5999 - round(age / PERIOD_S)


def test_rows_of_a_present_or_future_exposure_are_the_newest(ring: Ring) -> None:
    for exposed in (100.0, 100.5):
        rows = rows_at(ring, exposed)
        assert 1 <= len(rows) <= 3
        assert rows[-1, 0] == 5999


def test_rows_of_an_exposure_before_the_ring_are_its_oldest(ring: Ring) -> None:
    rows = rows_at(ring, 0.0)

    assert len(rows) > 40
    assert rows[0, 0] >= 6000 - RING_ROWS


def test_empty_ring_has_no_rows() -> None:
    ring = Ring(WIDTH)
    try:
        assert len(rows_at(ring, 1.0)) == 0
    finally:
        ring.close(remove=True)


def test_camera_without_calibration_and_station_without_telemetry_have_a_reason() -> None:
    supervisor = Supervisor(load_station(None).bench())
    try:
        found = overlay(supervisor, CameraFile(device="/dev/v4l/by-id/usb-none"), 1.0)
        assert (found.reason, found.tubes, found.tip_measured) == (NO_CALIBRATION, (), None)
        found = overlay(supervisor, CameraFile(), 1.0)
        assert (found.reason, found.width, found.height) == ("the station has no current telemetry", 640, 480)
    finally:
        supervisor.ring.close(remove=True)
