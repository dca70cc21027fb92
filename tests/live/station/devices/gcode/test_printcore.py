"""Printrun's `printcore` as an independent judge of the simulated Marlin board: numbers, checksums, repeated lines."""

import json
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from station.devices.gcode.protocol import BAUDS, Position, parse
from station.lab.config import LabConfig
from station.lab.lab_server import LabServer
from station.lab.simulated_gcode import SimulatedBoard
from tests.harness.root import ROOT
from tests.harness.running_lab import running
from tests.harness.waiting import until

pytest.importorskip("printrun", reason="needs the sender Printrun: pip install --no-deps Printrun")

PARK = np.array([0.2, 1.2, -0.08])


class Host:
    """A process with `printcore`."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        self._lines, self._results = process.stdin, process.stdout

    def start(self, lines: list[str]) -> None:
        """Print a list of G-code."""
        self._lines.write(f"{json.dumps(lines)}\n")
        self._lines.flush()

    def finish(self) -> list[str]:
        """Wait for the end of the print, and return the lines that the board has sent meanwhile."""
        return json.loads(self._results.readline())


@pytest.fixture
def lab(paper) -> Iterator[LabServer]:
    with running(LabServer(paper, LabConfig(stages="marlin"), 0, PARK, pty=True, homed=True)) as lab:
        yield lab


@pytest.fixture
def board(lab) -> SimulatedBoard:
    chain = lab.lab.chain
    assert isinstance(chain, SimulatedBoard)
    return chain


@pytest.fixture
def host(lab) -> Iterator[Host]:
    command = [sys.executable, "-m", "tests.harness.printcore_host", lab.endpoints["marlin"], str(BAUDS["marlin"])]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        yield Host(process)


def motions(first: float, count: int) -> list[str]:
    return [f"G1 X{first + 0.1 * number:.2f} F600" for number in range(count)]


def test_board_executes_the_numbered_lines_of_the_library(board, host):
    host.start(["G92 X10.00", *motions(10.0, 40), "M114 R"])
    received = host.finish()
    assert sum(line.startswith("ok") for line in received) >= 42
    assert not any(line.startswith(("Resend", "Error")) for line in received)
    positions = [message for line in received if isinstance(message := parse("marlin", line, "XYZ"), Position)]
    assert positions[-1].logical[0] <= 13.9
    assert until(lambda: not board.planner.moving)
    assert board.planner.end[0] + board.offsets[0] == pytest.approx(13.9)


def test_library_repeats_the_lines_that_the_board_requests(board, host):
    start = board.planner.end[0]
    host.start(["G92 X10.00", *motions(10.0, 100)])
    for number in range(5):
        assert until(lambda done=number: board.planner.end[0] > start + 1.5 * done)
        board.receive(b"#", board.time)  # a byte of noise within a line or before it
    received = host.finish()
    assert sum(line.startswith("Resend") for line in received) >= 1
    assert until(lambda: not board.planner.moving)
    assert board.planner.end[0] + board.offsets[0] == pytest.approx(19.9)
