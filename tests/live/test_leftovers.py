"""What a test leaves behind fails it by name; what was there before does not."""

import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from tests.harness.leftovers import nothing_left_behind

#: Both end with their input; the second one serves meanwhile.
CHILD = "import sys; print(flush=True); sys.stdin.read()"
SERVER = f"import socket; kept = socket.create_server(('127.0.0.1', 0)); {CHILD}"


@pytest.fixture
def kept() -> Iterator[ExitStack]:
    """What leaks in a test ends here."""
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
def test_what_is_left_behind_fails_by_name_and_who_comes_next_is_not_blamed(
    kept: ExitStack, leak: Callable[[ExitStack], None], named: str
) -> None:
    with pytest.raises(pytest.fail.Exception, match=named), nothing_left_behind(0.0):
        leak(kept)
    with nothing_left_behind(0.0):
        pass


def test_the_tidy_and_what_ends_within_the_grace_pass(kept: ExitStack) -> None:
    with nothing_left_behind(0.0), ExitStack() as tidy:
        for leak in (thread, child, tcp, udp, port_of_a_child):
            leak(tidy)
    with nothing_left_behind(600.0):
        thread(kept)
        threading.Timer(0.05, kept.close).start()


def test_what_was_there_before_may_start_more(kept: ExitStack) -> None:
    code = (
        "import socket, sys; print(flush=True); sys.stdin.readline();"
        " kept = socket.create_server(('127.0.0.1', 0)); print(flush=True); sys.stdin.read()"
    )
    pipe = subprocess.PIPE
    before = kept.enter_context(subprocess.Popen([sys.executable, "-S", "-c", code], stdin=pipe, stdout=pipe))
    assert before.stdin is not None
    assert before.stdout is not None
    before.stdout.readline()
    with nothing_left_behind(0.0):
        before.stdin.write(b"\n")
        before.stdin.flush()
        before.stdout.readline()
