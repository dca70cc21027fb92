"""One device, one station: locks between real processes, whichever way a port is named."""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from station.devices.links.link import DatagramLink, LinkError, SerialLink
from station.devices.links.port_lock import PortLock, PortTaken, device_name, lock_file

HOLD = """
import sys
from station.devices.links.link import DatagramLink, SerialLink
url = sys.argv[1]
link = DatagramLink("127.0.0.1", int(url)) if url.isdigit() else SerialLink(url, 9600)
print("open", flush=True)
sys.stdin.read(1)
link.close()
print("closed", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def terminal() -> Iterator[str]:
    master, slave = os.openpty()
    yield os.ttyname(slave)
    os.close(master)
    os.close(slave)


@pytest.fixture
def holder(environment) -> Iterator[Callable[[str], subprocess.Popen[bytes]]]:
    """Another process that has a device open until it reads a line."""
    processes: list[subprocess.Popen[bytes]] = []

    def hold(url: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-c", HOLD, url]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        processes.append(process)
        assert process.stdout
        assert process.stdout.readline() == b"open\n"
        return process

    yield hold
    for process in processes:
        process.kill()
        process.communicate()


def test_a_port_that_another_process_has_is_refused_by_name_and_process(terminal, holder, tmp_path: Path):
    process = holder(terminal)
    link = tmp_path / "stages"  # another name of the same port
    link.symlink_to(terminal)
    for name in (terminal, str(link)):
        with pytest.raises(LinkError, match=f"{name} is in use by process {process.pid}"):
            SerialLink(name, 9600)

    assert process.stdin
    assert process.stdout
    process.stdin.write(b"\n")
    process.stdin.flush()
    assert process.stdout.readline() == b"closed\n"
    SerialLink(str(link), 9600).close()


def test_a_killed_process_holds_nothing(terminal, holder):
    process = holder(terminal)
    process.send_signal(signal.SIGKILL)
    process.wait()

    SerialLink(terminal, 9600).close()


def test_a_force_sensor_has_one_host(holder):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
        box.bind(("127.0.0.1", 0))
        port = box.getsockname()[1]
        process = holder(str(port))
        with pytest.raises(LinkError, match=f"udp://localhost:{port} is in use by process {process.pid}"):
            DatagramLink("localhost", port)


def test_a_second_link_of_the_same_process_is_refused_too(terminal):
    first = SerialLink(terminal, 9600)
    with pytest.raises(LinkError, match=str(os.getpid())):
        SerialLink(terminal, 9600)
    first.close()
    first.close()  # more than once does no harm
    SerialLink(terminal, 9600).close()


def test_a_port_that_cannot_be_opened_is_not_held(tmp_path: Path):
    nowhere = str(tmp_path / "ttyUSB7")
    for _ in range(2):
        with pytest.raises(LinkError, match=r"ttyUSB7 cannot be opened: .* plugged in"):
            SerialLink(nowhere, 9600)


def test_a_line_by_tcp_is_one_links(terminal):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        first = SerialLink(f"socket://127.0.0.1:{port}", 9600)
        with pytest.raises(LinkError, match="in use"):
            SerialLink(f"socket://localhost:{port}", 9600)
        first.close()


@pytest.mark.parametrize(
    ("url", "name"),
    [
        ("socket://127.0.0.1:9001", "socket://127.0.0.1:9001"),
        ("socket://localhost:9001", "socket://127.0.0.1:9001"),
        ("socket://no-such-host.invalid:9001", "socket://no-such-host.invalid:9001"),
        ("socket://127.0.0.1:port", "socket://127.0.0.1:port"),
    ],
)
def test_a_host_is_known_by_its_address(url, name):
    assert device_name(url) == name


def test_a_child_does_not_keep_what_its_parent_lets_go(terminal):
    lock = PortLock(terminal)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(writing)
        os.read(reading, 1)  # until the parent is done
        os._exit(0)
    try:
        lock.release()
        PortLock(terminal).release()
    finally:
        os.close(writing)
        os.close(reading)
        os.waitpid(child, 0)


def test_a_lock_that_is_no_file_is_refused_with_its_path(terminal, tmp_path: Path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    path = lock_file(terminal)
    assert path.parent == tmp_path
    path.symlink_to("/dev/null")
    with pytest.raises(PortTaken, match=re.escape(str(path))):
        PortLock(terminal)


def test_the_file_may_be_locked_by_any_user_and_says_who_has_it(terminal, tmp_path: Path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    mask = os.umask(0o077)
    try:
        lock = PortLock(terminal)
    finally:
        os.umask(mask)
    path = lock_file(terminal)
    assert path.stat().st_mode & 0o777 == 0o666
    assert path.read_text() == str(os.getpid())
    lock.release()
    assert not path.exists()


def test_of_many_that_want_a_device_one_at_a_time_has_it(terminal, tmp_path: Path, monkeypatch):
    """Threads open and close it as fast as they can; the file comes and goes under them."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    inside: list[int] = []
    most: list[int] = []
    had = [0] * 4

    def want(me: int) -> None:
        for _ in range(500):
            try:
                lock = PortLock(terminal)
            except PortTaken:
                continue
            inside.append(me)
            most.append(len(inside))
            inside.remove(me)
            had[me] += 1
            lock.release()

    threads = [threading.Thread(target=want, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(most) == {1}
    assert sum(had) > 0
    assert list(tmp_path.iterdir()) == []
