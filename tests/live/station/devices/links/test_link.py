"""Exclusive access to a device: locks between real processes, for every name of a port."""

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

from station.devices.links.link import DatagramLink, LinkError, PortInUse, PortLock, SerialLink, device_name, lock_file

KEEP_OPEN = """
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

    def keep_open(url: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-c", KEEP_OPEN, url]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment)
        processes.append(process)
        assert process.stdout
        assert process.stdout.readline() == b"open\n"
        return process

    yield keep_open
    for process in processes:
        process.kill()
        process.communicate()


def test_port_in_use_is_refused_with_its_name_and_the_process_number(terminal, holder, tmp_path: Path):
    process = holder(terminal)
    link = tmp_path / "stages"  # the symbolic link is another name of the same port
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


def test_lock_of_a_killed_process_is_released(terminal, holder):
    process = holder(terminal)
    process.send_signal(signal.SIGKILL)
    process.wait()

    SerialLink(terminal, 9600).close()


def test_force_sensor_accepts_one_link_only(holder):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
        box.bind(("127.0.0.1", 0))
        port = box.getsockname()[1]
        process = holder(str(port))
        with pytest.raises(LinkError, match=f"udp://localhost:{port} is in use by process {process.pid}"):
            DatagramLink("localhost", port)


def test_second_link_of_the_same_process_is_refused(terminal):
    first = SerialLink(terminal, 9600)
    with pytest.raises(LinkError, match=str(os.getpid())):
        SerialLink(terminal, 9600)
    first.close()
    first.close()  # a second call has no effect
    SerialLink(terminal, 9600).close()


def test_port_that_cannot_be_opened_stays_unlocked(tmp_path: Path):
    nowhere = str(tmp_path / "ttyUSB7")
    for _ in range(2):
        with pytest.raises(LinkError, match=r"ttyUSB7 cannot be opened: .* plugged in"):
            SerialLink(nowhere, 9600)


def test_tcp_line_accepts_one_link_only(terminal):
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
def test_device_name_contains_the_address_of_the_host(url, name):
    assert device_name(url) == name


def test_child_process_does_not_keep_the_lock_that_its_parent_releases(terminal):
    lock = PortLock(terminal)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(writing)
        os.read(reading, 1)  # wait until the parent has finished
        os._exit(0)
    try:
        lock.release()
        PortLock(terminal).release()
    finally:
        os.close(writing)
        os.close(reading)
        os.waitpid(child, 0)


def test_lock_path_that_is_no_file_is_refused_with_its_path(terminal, tmp_path: Path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    path = lock_file(terminal)
    assert path.parent == tmp_path
    path.symlink_to("/dev/null")
    with pytest.raises(PortInUse, match=re.escape(str(path))):
        PortLock(terminal)


def test_lock_file_can_be_locked_by_any_user_and_contains_the_process_number(terminal, tmp_path: Path, monkeypatch):
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


def test_device_is_locked_by_one_of_many_threads_at_a_time(terminal, tmp_path: Path, monkeypatch):
    """Threads lock and unlock the device as fast as they can, so the lock file is created and removed meanwhile."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    inside: list[int] = []
    most: list[int] = []
    had = [0] * 4

    def want(me: int) -> None:
        for _ in range(500):
            try:
                lock = PortLock(terminal)
            except PortInUse:
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
