"""Links on real ports: pseudo-terminals behind symbolic links, as adapters that come and go."""

import os
import select
import socket
from pathlib import Path

import pytest

from station.devices.links.link import LinkError, SerialLink, reopen


def heard(master: int) -> bytes:
    return os.read(master, 100) if select.select([master], [], [], 2.0)[0] else b""


def use_for_a_while(link: SerialLink) -> None:
    for _ in range(100):
        link.read()
        link.write(b"?")


def test_a_port_that_comes_back_as_another_one_is_reopened_by_its_name(tmp_path: Path):
    """/dev/serial/by-id points to ttyUSB0, and after plugging in again to ttyUSB1."""
    by_id = tmp_path / "usb-stages"
    first, second = os.openpty(), os.openpty()
    by_id.symlink_to(os.ttyname(first[1]))
    link = SerialLink(str(by_id), 9600)
    try:
        link.set_baud(115200)
        link.write(b"one")
        assert heard(first[0]) == b"one"
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
        assert heard(second[0]) == b"two"
        os.write(second[0], b"three")
        select.select([link._port.fileno()], [], [], 2.0)
        assert link.read() == b"three"
    finally:
        link.close()
        for file in second:
            os.close(file)


def test_a_line_by_tcp_is_reopened_when_its_host_is_back():
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


def test_a_line_over_tcp_sends_each_message_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = SerialLink(f"socket://127.0.0.1:{server.getsockname()[1]}", 9600)
        try:
            assert link._port._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        finally:
            link.close()
