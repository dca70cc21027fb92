"""The gateway's process: how it begins and ends, and what it shows when nothing comes any more."""

import socket
import subprocess
import sys

import psutil
import pytest
from pyigtl import OpenIGTLinkClient

from station.control.child import Child
from station.control.clock import REAL_TIME
from station.control.states import State
from tests.harness.gateway import ANY, PAPER, eventually, gateway
from tests.harness.root import ROOT
from web.gateway.messages import Problem, Setup
from web.gateway.process import run_gateway
from web.gateway.seen import Told
from web.gateway.wanted import Address, Wanted


def test_it_is_listed_by_its_name_and_leaves_nothing() -> None:
    with gateway(Wanted(igtl=ANY, foxglove=ANY)) as running:
        assert running.process.name() == "ctr-gateway"
        assert len(running.lines) == 2


def test_it_says_where_anybody_may_look() -> None:
    with gateway(Wanted(igtl=Address("0.0.0.0", 0))) as running:
        assert running.lines[0].endswith(", open to everybody who reaches it")


@pytest.mark.parametrize("name", ["igtl", "foxglove", "ros2"])
def test_a_port_that_is_taken_is_said_so(name: str) -> None:
    with gateway(Wanted(igtl=ANY)) as running, socket.create_server(("127.0.0.1", 0)) as taken:
        wanted = Wanted(**{name: Address("127.0.0.1", taken.getsockname()[1])})
        child = Child(run_gateway, Setup(wanted, PAPER, REAL_TIME, None, None), running.feed.ring.name, name="gateway")
        try:
            assert child.pipe.poll(60.0)
            answer = child.pipe.recv()
            assert isinstance(answer, Problem)
            assert answer.text.startswith(f"--{name} {wanted.igtl or wanted.foxglove or wanted.ros2} cannot be had")
            assert child.ended(20.0) == "with status 0"
        finally:
            child.close(5.0)


def test_numbers_that_no_longer_come_are_not_shown_as_if_they_did() -> None:
    with gateway(Wanted(igtl=ANY)) as running:
        client = OpenIGTLinkClient("127.0.0.1", running.port)
        try:
            assert client.wait_for_message("TipMeasured", timeout=30)
            running.feed.pause()
            eventually(lambda: client.wait_for_message("TipMeasured", timeout=0.5) is None)
            running.tell(Told(State.FAULT, "the control process has ended"))
            while client.wait_for_message("Cause", timeout=30).string != "the control process has ended":
                pass
            assert client.wait_for_message("TipMeasured", timeout=0.2) is None
        finally:
            client.stop()


def test_it_ends_with_its_parent() -> None:
    command = [sys.executable, "-m", "tests.harness.gateway"]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert parent.stdout is not None
    child = psutil.Process(int(parent.stdout.readline()))
    parent.kill()
    parent.wait()
    parent.stdout.close()
    eventually(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE)
