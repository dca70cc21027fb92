"""Child processes: messages, end on request, and kill; forked children share nothing with their parent but its code."""

import contextlib
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

import psutil
import pytest

from station.control.child_process import ChildProcess
from tests.harness.root import ROOT
from tests.harness.waiting import NET


def echo(word: str, pipe: Connection, parent: int) -> None:
    """Send a word and the parent's pid, then echo messages until None."""
    pipe.send((word, parent))
    while (message := pipe.recv()) is not None:
        pipe.send(message)


def deaf(pipe: Connection, parent: int) -> None:
    pipe.send("here")
    time.sleep(600.0)


@pytest.fixture
def child() -> Iterator[ChildProcess]:
    child = ChildProcess(echo, "hello", name="echo")
    yield child
    child.close(10.0)


def test_child_process_receives_its_arguments_its_pipe_and_its_parents_pid(child: ChildProcess) -> None:
    assert child.pipe.recv() == ("hello", os.getpid())
    child.send("more")
    assert child.pipe.recv() == "more"
    assert child.alive
    assert child.pid not in (0, os.getpid())


def test_child_process_ends_on_request(child: ChildProcess) -> None:
    child.end(100.0)
    assert not child.alive
    assert child.ended() == "with status 0"
    child.send("never read")


def test_ctrl_c_in_the_terminal_does_not_end_a_child_even_during_its_start(child: ChildProcess) -> None:
    os.kill(child.pid, signal.SIGINT)
    assert child.pipe.recv() == ("hello", os.getpid())
    os.kill(child.pid, signal.SIGINT)
    child.send("more")
    assert child.pipe.recv() == "more"


def test_exit_text_of_a_killed_child_process_names_the_signal(child: ChildProcess) -> None:
    os.kill(child.pid, signal.SIGKILL)
    assert child.ended() == "by signal 9"


def test_exit_status_of_a_child_process_is_known_while_other_threads_query_it() -> None:
    for _ in range(10):
        child, over = ChildProcess(deaf, name="deaf"), threading.Event()
        assert child.pipe.recv() == "here"

        def query(child: ChildProcess = child, over: threading.Event = over) -> None:
            while not over.is_set():
                _ = child.alive

        threads = [threading.Thread(target=query) for _ in range(4)]
        for thread in threads:
            thread.start()
        child.kill()
        text = child.ended()
        over.set()
        for thread in threads:
            thread.join()
        child.close(0.0)
        assert text == "by signal 9"


def test_child_process_that_ignores_the_request_to_end_is_killed() -> None:
    child = ChildProcess(deaf, name="deaf")
    assert child.pipe.recv() == "here"
    assert child.ended(0.01) == "without an exit status yet"
    child.close(0.05)
    assert child.ended() == "by signal 9"


#: Filled by a parent at run time, so that only its forked children find it filled.
KNOWN: list[str] = []


def describe(pipe: Connection, parent: int) -> None:
    """Send facts about this process, and end when the pipe ends."""
    sockets = 0
    for file in list(Path("/proc/self/fd").iterdir()):
        with contextlib.suppress(FileNotFoundError):  # the descriptor with which the list was read
            sockets += str(file.readlink()).startswith("socket:")
    pipe.send(
        {
            "pid": os.getpid(),
            "is the parent's child": os.getppid() == parent,
            "forked": bool(KNOWN),
            "sockets": sockets,
            "default SIGTERM": signal.getsignal(signal.SIGTERM) is signal.SIG_DFL,
            "collects garbage": gc.isenabled(),
        }
    )
    with contextlib.suppress(EOFError):
        pipe.recv()


def be_parent(threads: int) -> None:
    """Run a parent with a port, a signal handler, other children and further threads; print what its child is like."""
    KNOWN.append("the parent")
    signal.signal(signal.SIGTERM, lambda *_: None)
    gc.disable()  # as during the start of a station
    first = ChildProcess(describe, name="first")
    first.pipe.recv()
    with socket.create_server(("127.0.0.1", 0)):
        for _ in range(threads):
            threading.Thread(target=threading.Event().wait, daemon=True).start()
        child = ChildProcess(describe, name="child")
        sys.stdout.write(f"{json.dumps(child.pipe.recv())}\n")
        sys.stdout.flush()
        sys.stdin.read()
    child.close(NET)
    first.close(NET)


@pytest.mark.parametrize(("threads", "forked"), [(0, True), (1, False)])
def test_only_a_parent_without_further_threads_forks_and_no_child_keeps_its_sockets_handlers_or_life(
    threads: int, forked: bool
) -> None:
    code = f"from {__name__} import be_parent; be_parent({threads})"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as parent:
        assert parent.stdout is not None
        about = json.loads(parent.stdout.readline())
        child = psutil.Process(about.pop("pid"))
        expected = {"is the parent's child": True, "sockets": 1, "default SIGTERM": True, "collects garbage": True}
        assert about == {"forked": forked, **expected}
        parent.kill()
    child.wait(NET)
