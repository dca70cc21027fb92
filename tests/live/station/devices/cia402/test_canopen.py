"""The library `canopen` as an independent judge of the simulated drives: SDOs, states, process data, emergencies."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from station.lab.config import LabConfig
from station.lab.lab_server import LabServer
from tests.harness.root import ROOT
from tests.harness.running_lab import running
from tests.harness.waiting import until

pytest.importorskip("canopen")

PARK = np.array([0.2, 1.2, -0.08])
Host = Callable[[str], Any]


@pytest.fixture
def lab(paper) -> Iterator[LabServer]:
    with running(LabServer(paper, LabConfig(stages="cia402"), 0, PARK, homed=True)) as lab:
        yield lab


@pytest.fixture
def host(lab) -> Iterator[Host]:
    port = urlsplit(lab.endpoints["cia402"]).port
    command = [sys.executable, "-m", "tests.harness.canopen_host", str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:

        def send(line: str) -> Any:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(f"{line}\n")
            process.stdin.flush()
            return json.loads(process.stdout.readline())

        yield send


def enable(host: Host, node: int) -> None:
    assert host(f"write {node} 6060 0 3 1") == "written"
    for word, status in ((0x06, 0x231), (0x07, 0x233), (0x0F, 0x237)):
        assert host(f"write {node} 6040 0 {word} 2") == "written"
        assert host(f"read {node} 6041 0") & 0xFFF == status


def test_library_enables_moves_and_stops_a_drive(host):
    assert host("read 3 1000 0") & 0xFFFF == 402
    enable(host, 3)
    before = host("read 3 6064 0")
    assert host("write 3 60FF 0 20000 4") == "written"
    assert until(lambda: host("read 3 6064 0") > before)
    host("write 3 6040 0 11 2")  # quick stop
    assert until(lambda: host("read 3 606C 0") == 0)


def test_errors_are_the_abort_codes_that_the_library_expects(host):
    assert host("read 1 5555 0") == "aborted 0x06020000"
    assert host("write 1 6041 0 0 2") == "aborted 0x06010002"
    assert host("write 1 6040 0 0 4") == "aborted 0x06070010"
    assert host("write 1 6060 0 9 1") == "aborted 0x06090030"


def test_process_data_answer_to_a_sync_in_the_state_operational(host):
    for line in (
        "1800 1 3221225857 4", "1800 2 1 1", "1A00 0 0 1", "1A00 1 1614872592 4", "1A00 2 1617166368 4",
        "1A00 0 2 1", "1800 1 1073742209 4",
    ):  # fmt: skip
        assert host(f"write 1 {line}") == "written"
    host("nmt 1 OPERATIONAL")
    status, position = host("read 1 6041 0"), host("read 1 6064 0")
    assert host("sync 1") == (status.to_bytes(2, "little") + position.to_bytes(4, "little")).hex()


def test_drive_reports_that_the_heartbeat_of_its_host_is_missing(host):
    enable(host, 2)
    assert host(f"write 2 1016 1 {127 << 16 | 200} 4") == "written"
    host("heartbeat 2")
    assert host("emergency 2") == 0x8130
    assert host("read 2 6041 0") & 0x6F == 0x07  # quick stop active
