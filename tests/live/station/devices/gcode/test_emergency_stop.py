"""The emergency stop of a G-code board on a real pseudo-terminal, after the process that moved the board has died."""

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from station.control.clock import REAL_TIME_CLOCK
from station.devices.gcode.emergency_stop import stop_board
from station.devices.gcode.stages import GCODE
from station.devices.interfaces import EmergencyStop, NotStopped
from station.lab.config import LabConfig
from station.lab.lab_server import LabServer
from station.lab.simulated_gcode import SimulatedBoard
from tests.harness.root import ROOT
from tests.harness.running_lab import running
from tests.harness.waiting import until

PARK = np.array([0.2, 1.2, -0.08])
#: A process that fills the planner with motions of 1 s each and sends half a line. Then it keeps the port open.
HOST = """
import sys, time
from station.devices.gcode.protocol import BAUDS
from station.devices.links.link import SerialLink

port, dialect = sys.argv[1:]
link = SerialLink(port, BAUDS[dialect])
for number in range(1, 13):
    motion = f"X{12.0 + 2.0 * number:.2f}F120"
    link.write((f"$J=G53{motion}\\n" if dialect == "grbl" else f"G1 {motion}\\n").encode())
link.write(b"$J=G53X40.0" if dialect == "grbl" else b"G1 X40.0")
print("sent", flush=True)
time.sleep(600)
"""


@pytest.fixture(params=["grbl", "marlin"])
def lab(paper, request) -> Iterator[LabServer]:
    config = LabConfig(stages=request.param)
    with running(LabServer(paper, config, 0, PARK, pty=True, homed=True)) as lab:
        yield lab


def board(lab: LabServer) -> SimulatedBoard:
    chain = lab.lab.chain
    assert isinstance(chain, SimulatedBoard)
    return chain


def port(lab: LabServer) -> str:
    return lab.endpoints[board(lab).dialect]


def emergency_stop(lab: LabServer, paper) -> EmergencyStop:
    return GCODE.emergency_stop({"port": port(lab), "dialect": board(lab).dialect}, paper)


@pytest.fixture
def host(lab) -> Iterator[subprocess.Popen[str]]:
    """A process that has set the board in motion and holds its port."""
    command = [sys.executable, "-c", HOST, port(lab), board(lab).dialect]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "sent\n"
            assert until(lambda: board(lab).planner.moving)
            yield process
        finally:
            process.kill()


def test_board_stops_after_its_host_was_killed_within_a_line(lab, host, paper):
    host.send_signal(signal.SIGKILL)
    host.wait()
    assert board(lab).planner.moving
    result = emergency_stop(lab, paper)(REAL_TIME_CLOCK)
    assert result.startswith(f"3 stages on {port(lab)} stop, commanded ")
    assert not board(lab).planner.moving


def test_emergency_stop_retries_a_port_until_a_dying_process_releases_it(lab, host, paper):
    death = threading.Timer(0.3, host.kill)
    death.start()
    result = emergency_stop(lab, paper)(REAL_TIME_CLOCK)
    death.join()
    assert result.startswith("3 stages on")
    assert not board(lab).planner.moving


def test_emergency_stop_reports_a_port_that_does_not_exist():
    with pytest.raises(NotStopped, match="the stages on /dev/not-there cannot be commanded to stop"):
        stop_board("/dev/not-there", 115200, "grbl", ("X",), REAL_TIME_CLOCK, patience=0.1)
