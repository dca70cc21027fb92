"""A test leaves nothing running behind: no thread, no child process, no port that is open to others.

What was there before it (a server or a browser that many share, say) is not the test's, nor what that starts.
The look costs a fraction of a millisecond: it comes twice in each of thousands of tests.
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
    """Fail when there is something left `grace` [s] after the end."""
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
        with suppress(FileNotFoundError, ProcessLookupError):  # a thread that has just ended
            children |= {int(pid) for pid in (task / "children").read_text().split()}
    # The interpreter's own tracker of shared memory stays until the interpreter ends.
    children.discard(getattr(resource_tracker._resource_tracker, "_pid", None) or 0)
    return _Running(set(threading.enumerate()), children, set(_sockets()))


def _sockets() -> dict[str, int]:
    """The sockets that are open here, by their number in the system, and the file that each is."""
    found = {}
    for file in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):  # the one of this look
            name = str(file.readlink())
            if name.startswith("socket:"):
                found[name] = int(file.name)
    return found


def _names(before: _Running) -> set[str]:
    """What is new."""
    now = _running()
    left = {f"thread {thread.name}" for thread in now.threads - before.threads}
    if now.sockets - before.sockets:
        mine = {file for name, file in _sockets().items() if name not in before.sockets}
        left |= _ports(psutil.Process(), mine)
    for pid in now.children - before.children:
        with suppress(psutil.NoSuchProcess):  # ended while it was looked at
            child = psutil.Process(pid)
            for process in (child, *child.children(recursive=True)):
                left |= {f"process {process.pid} ({process.name()})", *_ports(process)}
    return left


def _ports(process: psutil.Process, files: set[int] | None = None) -> set[str]:
    """Ports of a process that are open to others, of these files only."""
    left = set()
    for connection in process.net_connections():
        serves = connection.status == psutil.CONN_LISTEN
        receives = connection.type == socket.SOCK_DGRAM and connection.laddr and not connection.raddr
        if (serves or receives) and (files is None or connection.fd in files):
            left.add(f"port {connection.laddr.port}")
    return left
