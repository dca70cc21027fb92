"""A USB adapter is found again by its serial number or its socket, never by a guess."""

import os
from pathlib import Path

import pytest

from station.devices.links.link import UsbPort, describe, find, usb_ports

FTDI = (0x0403, 0x6001)
PROLIFIC = (0x067B, 0x2303)


def usb(device: str, kind: tuple[int, int] = FTDI, serial: str = "", location: str = "1-1") -> UsbPort:
    return UsbPort(device, *kind, serial, location)


AURORA = usb("/dev/ttyUSB0", serial="P3-00123", location="1-1.1")
STAGES = usb("/dev/ttyUSB1", PROLIFIC, location="1-1.2")


def test_adapter_with_a_serial_number_is_found_in_another_socket():
    moved = AURORA._replace(device="/dev/ttyUSB3", location="2-4")
    assert find(AURORA, [STAGES, moved]) == "/dev/ttyUSB3"


def test_similar_adapter_with_another_serial_number_is_not_used():
    assert find(AURORA, [AURORA._replace(serial="P3-00124")]) is None
    assert find(AURORA, [STAGES]) is None
    assert find(STAGES, []) is None


def test_adapter_without_a_serial_number_is_found_by_its_socket():
    swapped = [
        STAGES._replace(device="/dev/ttyUSB0", location="1-1.3"),
        STAGES._replace(device="/dev/ttyUSB2"),
    ]
    assert find(STAGES, swapped) == "/dev/ttyUSB2"


def test_moved_adapter_without_a_serial_number_is_found_only_if_unique():
    elsewhere = STAGES._replace(device="/dev/ttyUSB5", location="3-1")
    assert find(STAGES, [AURORA, elsewhere]) == "/dev/ttyUSB5"
    assert find(STAGES, [elsewhere, STAGES._replace(device="/dev/ttyUSB6", location="3-2")]) is None


def test_ports_of_one_adapter_are_distinguished():
    first = usb("/dev/ttyUSB0", serial="FT4", location="1-1:1.0")
    second = usb("/dev/ttyUSB1", serial="FT4", location="1-1:1.1")
    later = [second._replace(device="/dev/ttyUSB4", location="1-3:1.1"), first._replace(device="/dev/ttyUSB5")]
    assert find(first, later) == "/dev/ttyUSB5"
    assert find(second, later) == "/dev/ttyUSB4"


def test_port_is_described_by_any_of_its_names(tmp_path: Path):
    master, slave = os.openpty()
    try:
        by_id = tmp_path / "usb-Prolific-if00-port0"
        by_id.symlink_to(os.ttyname(slave))
        port = usb(os.ttyname(slave))
        assert describe(str(by_id), [STAGES, port]) == port
        assert describe(str(tmp_path / "nothing"), [STAGES, port]) is None
    finally:
        os.close(master)
        os.close(slave)


def test_usb_ports_are_listed_with_their_numbers():
    for port in usb_ports():  # most test computers have no USB port with an adapter, so the list may be empty
        assert Path(port.device).exists()
        assert port.vendor > 0


@pytest.mark.parametrize(
    ("port", "words"),
    [(AURORA, "USB adapter 0403:6001 with serial number P3-00123"), (STAGES, "USB adapter 067b:2303 at 1-1.2")],
)
def test_description_names_serial_number_or_socket(port, words):
    assert str(port) == words
