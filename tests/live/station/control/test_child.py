"""Processes of the station's own: told, asked to end, and made to."""

import os
import signal
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection

import pytest

from station.control.child import Child


def echo(word: str, pipe: Connection, parent: int) -> None:
    """Says a word and its parent's number, then what it hears, until it hears None."""
    pipe.send((word, parent))
    while (heard := pipe.recv()) is not None:
        pipe.send(heard)


def deaf(pipe: Connection, parent: int) -> None:
    pipe.send("here")
    time.sleep(600.0)


@pytest.fixture
def child() -> Iterator[Child]:
    child = Child(echo, "hello", name="echo")
    yield child
    child.close(10.0)


def test_it_is_given_its_arguments_its_pipe_and_its_parent(child: Child) -> None:
    assert child.pipe.recv() == ("hello", os.getpid())
    child.tell("more")
    assert child.pipe.recv() == "more"
    assert child.alive
    assert child.pid not in (0, os.getpid())


def test_asked_to_end_it_ends(child: Child) -> None:
    child.end(100.0)
    assert not child.alive
    assert child.ended() == "with status 0"
    child.tell("nobody hears that")


def test_ctrl_c_in_the_terminal_does_not_end_it_not_even_while_it_starts(child: Child) -> None:
    os.kill(child.pid, signal.SIGINT)
    assert child.pipe.recv() == ("hello", os.getpid())
    os.kill(child.pid, signal.SIGINT)
    child.tell("more")
    assert child.pipe.recv() == "more"


def test_killed_it_is_told_by_which_signal(child: Child) -> None:
    os.kill(child.pid, signal.SIGKILL)
    assert child.ended() == "by signal 9"


def test_one_that_does_not_listen_is_made_to_end() -> None:
    child = Child(deaf, name="deaf")
    assert child.pipe.recv() == "here"
    assert child.ended(0.01) == "not at all"
    child.close(0.05)
    assert child.ended() == "by signal 9"
