"""The gateway process: its start, its end, and its data when telemetry stops."""

import socket
import subprocess
import sys

import psutil
import pytest
from pyigtl import OpenIGTLinkClient

from station.control.child_process import ChildProcess
from station.control.clock import REAL_TIME_CLOCK
from station.control.states import State
from tests.harness.children import has_ended
from tests.harness.gateway import ANY, PAPER, eventually, gateway
from tests.harness.root import ROOT
from web.gateway.options import GatewayOptions, ListenAddress
from web.gateway.process import GatewayProblem, GatewaySetup, run_gateway
from web.gateway.snapshot import StationInfo


def test_the_gateway_process_has_its_name_and_leaves_no_files() -> None:
    with gateway(GatewayOptions(igtl=ANY, foxglove=ANY)) as running:
        assert running.process.name() == "ctr-gateway"
        assert len(running.lines) == 2


def test_the_gateway_reports_access_without_a_token() -> None:
    with gateway(GatewayOptions(igtl=ListenAddress("0.0.0.0", 0))) as running:
        assert running.lines[0].endswith(", open to every client that reaches it")


@pytest.mark.parametrize("name", ["igtl", "foxglove", "ros2"])
def test_the_gateway_reports_a_port_in_use(name: str) -> None:
    with gateway(GatewayOptions(igtl=ANY)) as running, socket.create_server(("127.0.0.1", 0)) as taken:
        wanted = GatewayOptions(**{name: ListenAddress("127.0.0.1", taken.getsockname()[1])})
        child = ChildProcess(
            run_gateway,
            GatewaySetup(wanted, PAPER, REAL_TIME_CLOCK, None, None),
            running.feed.ring.name,
            name="gateway",
        )
        try:
            assert child.pipe.poll(60.0)
            answer = child.pipe.recv()
            assert isinstance(answer, GatewayProblem)
            assert answer.text.startswith(f"--{name} {wanted.igtl or wanted.foxglove or wanted.ros2} is not available")
            assert child.ended(20.0) == "with status 0"
        finally:
            child.close(5.0)


def test_the_gateway_does_not_send_stale_telemetry_as_current() -> None:
    with gateway(GatewayOptions(igtl=ANY)) as running:
        client = OpenIGTLinkClient("127.0.0.1", running.port)
        try:
            assert client.wait_for_message("TipMeasured", timeout=30)
            running.feed.pause()
            eventually(lambda: client.wait_for_message("TipMeasured", timeout=0.5) is None)
            running.tell(StationInfo(State.FAULT, "the control process has ended"))
            while client.wait_for_message("Cause", timeout=30).string != "the control process has ended":
                pass
            assert client.wait_for_message("TipMeasured", timeout=0.2) is None
        finally:
            client.stop()


def test_the_gateway_ends_with_its_parent() -> None:
    command = [sys.executable, "-m", "tests.harness.gateway"]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert parent.stdout is not None
    child = psutil.Process(int(parent.stdout.readline()))
    parent.kill()
    parent.wait()
    parent.stdout.close()
    eventually(lambda: has_ended(child))
