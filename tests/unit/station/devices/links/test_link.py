"""Links on real ports: pseudo-terminals behind symbolic links, like adapters that are replugged."""

import os
import select
import socket
import tempfile
from pathlib import Path

import pytest

from station.devices.links.link import (
    LinkError,
    PortInUse,
    PortLock,
    SerialLink,
    UsbPort,
    clear_left_behind,
    describe,
    find,
    lock_file,
    reopen,
    usb_ports,
)


def received(master: int) -> bytes:
    return os.read(master, 100) if select.select([master], [], [], 2.0)[0] else b""


def fill(link: SerialLink) -> None:
    """Write far more than the size of any buffer."""
    for _ in range(100_000):
        link.write(bytes(1000))


def use_for_a_while(link: SerialLink) -> None:
    for _ in range(100):
        link.read()
        link.write(b"?")


def test_port_that_returns_as_another_device_is_reopened_by_its_name(tmp_path: Path):
    """/dev/serial/by-id points to ttyUSB0, and after plugging in again to ttyUSB1."""
    by_id = tmp_path / "usb-stages"
    first, second = os.openpty(), os.openpty()
    by_id.symlink_to(os.ttyname(first[1]))
    link = SerialLink(str(by_id), 9600)
    try:
        link.set_baud(115200)
        link.write(b"one")
        assert received(first[0]) == b"one"
        for file in first:
            os.close(file)
        with pytest.raises(LinkError, match="usb-stages"):
            use_for_a_while(link)
        by_id.unlink()
        with pytest.raises(LinkError, match=r"usb-stages cannot be opened"):
            reopen(link)
        by_id.symlink_to(os.ttyname(second[1]))
        assert reopen(link) is link
        link.write(b"two")
        assert received(second[0]) == b"two"
        os.write(second[0], b"three")
        select.select([link._port.fileno()], [], [], 2.0)
        assert link.read() == b"three"
    finally:
        link.close()
        for file in second:
            os.close(file)


def test_tcp_line_is_reopened_when_its_host_is_back():
    server = socket.create_server(("127.0.0.1", 0))
    port = server.getsockname()[1]
    link = SerialLink(f"socket://127.0.0.1:{port}", 9600)
    try:
        visitor, _ = server.accept()
        visitor.close()
        server.close()
        with pytest.raises(LinkError, match=str(port)):
            use_for_a_while(link)
        with pytest.raises(LinkError, match=f"socket://127.0.0.1:{port} cannot be opened"):
            reopen(link)
        server = socket.create_server(("127.0.0.1", port))
        reopen(link)
        visitor, _ = server.accept()
        link.write(b"here")
        assert visitor.recv(10) == b"here"
        visitor.close()
    finally:
        link.close()
        server.close()


def test_tcp_line_sends_each_message_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = SerialLink(f"socket://127.0.0.1:{server.getsockname()[1]}", 9600)
        try:
            assert link._port._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        finally:
            link.close()


@pytest.mark.parametrize("by", ["terminal", "tcp"])
def test_write_to_a_port_without_a_reader_raises_without_waiting(by):
    files = os.openpty()
    server = socket.create_server(("127.0.0.1", 0))
    url = os.ttyname(files[1]) if by == "terminal" else f"socket://127.0.0.1:{server.getsockname()[1]}"
    link = SerialLink(url, 9600)
    try:
        with pytest.raises(LinkError, match="accepts no data: its buffer is full"):
            fill(link)
    finally:
        link.close()
        server.close()
        for file in files:
            os.close(file)


def test_unlocked_files_are_removed_and_a_device_in_use_stays_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left, linked, other = lock_file("/dev/ttyUSB8"), lock_file("/dev/ttyUSB7"), tmp_path / "ctr-station-notes.lock"
    for path in (left, other):
        path.write_text("123456789")
    linked.symlink_to(other)
    lock = PortLock("/dev/ttyUSB9")

    clear_left_behind()

    assert not left.exists()
    assert linked.is_symlink()
    assert other.exists()
    with pytest.raises(PortInUse, match="two devices cannot use the same port"):
        PortLock("/dev/ttyUSB9")
    lock.release()
    PortLock("/dev/ttyUSB8").release()


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
    swapped = [STAGES._replace(device="/dev/ttyUSB0", location="1-1.3"), STAGES._replace(device="/dev/ttyUSB2")]
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
