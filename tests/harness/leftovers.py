"""Check that a test leaves no thread, no child process and no open port behind.

Whatever existed before the test, such as a shared server or browser, does not count, nor do processes that it starts.
The check takes a fraction of a millisecond, because it runs twice in each of thousands of tests.
"""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from typing import NamedTuple

import psutil
import pytest


@contextmanager
def nothing_left_behind(grace: float) -> Iterator[None]:
    """Fail if the body has left something running that still exists after `grace` [s]."""
    before = _running()
    yield
    give_up = time.monotonic() + grace
    while (left := _names(before)) and time.monotonic() < give_up:
        time.sleep(0.02)
    if left:
        pytest.fail("left behind: " + ", ".join(sorted(left)), pytrace=False)


class _Running(NamedTuple):
    threads: set[threading.Thread]
    children: set[int]
    sockets: set[str]


def _running() -> _Running:
    children = set()
    for task in Path("/proc/self/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # the thread has just ended
            children |= {int(pid) for pid in (task / "children").read_text().split()}
    # Python's resource tracker is no leftover, because it runs until the interpreter ends.
    children.discard(getattr(resource_tracker._resource_tracker, "_pid", None) or 0)
    return _Running(set(threading.enumerate()), children, set(_sockets()))


def _sockets() -> dict[str, int]:
    """Return the file descriptors of this process's open sockets, by the socket's inode number."""
    found = {}
    for file in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # the descriptor with which this function reads the list
            name = str(file.readlink())
            if name.startswith("socket:"):
                found[name] = int(file.name)
    return found


def _names(before: _Running) -> set[str]:
    """Return the names of the threads, processes and ports that exist now and did not exist before."""
    now = _running()
    left = {f"thread {thread.name}" for thread in now.threads - before.threads}
    if now.sockets - before.sockets:
        mine = {file for name, file in _sockets().items() if name not in before.sockets}
        left |= _ports(psutil.Process(), mine)
    for pid in now.children - before.children:
        with suppress(psutil.NoSuchProcess):  # the process ended during the check
            child = psutil.Process(pid)
            for process in (child, *child.children(recursive=True)):
                left |= {f"process {process.pid} ({process.name()})", *_ports(process)}
    return left


def _ports(process: psutil.Process, files: set[int] | None = None) -> set[str]:
    """Return the ports on which a process listens; if `files` is given, only the ports of these file descriptors."""
    left = set()
    for connection in process.net_connections():
        serves = connection.status == psutil.CONN_LISTEN
        receives = connection.type == socket.SOCK_DGRAM and connection.laddr and not connection.raddr
        if (serves or receives) and (files is None or connection.fd in files):
            left.add(f"port {connection.laddr.port}")
    return left
