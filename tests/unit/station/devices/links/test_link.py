"""Links on real ports: pseudo-terminals behind symbolic links, like adapters that are replugged."""

import os
import select
import socket
from pathlib import Path

import pytest

from station.devices.links.link import LinkError, SerialLink, reopen


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
