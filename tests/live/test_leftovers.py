"""The check for leftovers fails a test that leaves a thread, process or port behind, and names the leftover."""

import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from tests.harness.leftovers import nothing_left_behind

#: Code of two child processes that end when their input ends; the second one also opens a port.
CHILD = "import sys; print(flush=True); sys.stdin.read()"
SERVER = f"import socket; kept = socket.create_server(('127.0.0.1', 0)); {CHILD}"


@pytest.fixture
def kept() -> Iterator[ExitStack]:
    """Yield a stack that ends everything that a test leaves behind on purpose."""
    with ExitStack() as stack:
        yield stack


def thread(kept: ExitStack) -> None:
    over = threading.Event()
    lost = threading.Thread(target=over.wait, name="lost")
    lost.start()
    kept.callback(lost.join)
    kept.callback(over.set)


def child(kept: ExitStack, code: str = CHILD) -> None:
    pipe = subprocess.PIPE
    process = kept.enter_context(subprocess.Popen([sys.executable, "-S", "-c", code], stdin=pipe, stdout=pipe))
    assert process.stdout is not None
    process.stdout.readline()


def port_of_a_child(kept: ExitStack) -> None:
    child(kept, SERVER)


def tcp(kept: ExitStack) -> None:
    kept.enter_context(socket.create_server(("127.0.0.1", 0)))


def udp(kept: ExitStack) -> None:
    kept.enter_context(socket.socket(type=socket.SOCK_DGRAM)).bind(("127.0.0.1", 0))


@pytest.mark.parametrize(
    ("leak", "named"),
    [
        (thread, "^left behind: thread lost$"),
        (child, r"^left behind: process \d+ \(python[\d.]*\)$"),
        (tcp, r"^left behind: port \d+$"),
        (udp, r"^left behind: port \d+$"),
        (port_of_a_child, r"^left behind: port \d+, process \d+ \(python[\d.]*\)$"),
    ],
)
def test_leftover_thread_process_or_port_fails_its_own_test_by_name_and_not_the_next_one(
    kept: ExitStack, leak: Callable[[ExitStack], None], named: str
) -> None:
    with pytest.raises(pytest.fail.Exception, match=named), nothing_left_behind(0.0):
        leak(kept)
    with nothing_left_behind(0.0):
        pass
