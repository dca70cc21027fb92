"""The manufacturer's library as an independent judge of the simulated chain: addresses, message IDs and checksums."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

import numpy as np
import pytest

from station.lab.config import LabConfig
from station.lab.lab_server import LabServer
from tests.harness.root import ROOT
from tests.harness.running_lab import running
from tests.harness.waiting import until

pytest.importorskip("zaber_motion")

PARK = np.array([0.2, 1.2, -0.08])
#: Sends a command to an axis of a device, and returns device, OK or RJ, status, flag and data of each answer.
Host = Callable[[int, int, str], list[list[str]]]


@pytest.fixture
def lab(paper) -> Iterator[LabServer]:
    with running(LabServer(paper, LabConfig(stages="zaber_ascii"), 0, PARK, homed=True)) as lab:
        yield lab


@pytest.fixture
def host(lab) -> Iterator[Host]:
    port = urlsplit(lab.endpoints["zaber_ascii"]).port
    command = [sys.executable, "-m", "tests.harness.zaber_motion_host", str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:

        def send(device: int, axis: int, text: str) -> list[list[str]]:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(f"{device} {axis} {text}\n")
            process.stdin.flush()
            return json.loads(process.stdout.readline())

        yield send


def test_library_moves_and_stops_an_axis_by_generic_commands(host):
    before = int(host(3, 1, "get pos")[0][4])
    assert host(3, 1, "move vel 20000") == [[3, "OK", "BUSY", "--", "0"]]
    assert until(lambda: int(host(3, 1, "get pos")[0][4]) > before)
    host(3, 1, "stop")
    assert until(lambda: host(3, 1, "")[0][2] == "IDLE")


def test_checksums_of_the_chain_agree_with_the_library(host):
    for device in (1, 2, 3):
        host(device, 0, "set comm.checksum 1")
        assert host(device, 0, "get comm.checksum") == [[device, "OK", "IDLE", "--", "1"]]


def test_broadcast_is_answered_by_every_device(host):
    assert {answer[0]: answer[4] for answer in host(0, 0, "get system.serial")} == {1: "2001", 2: "2002", 3: "2003"}


def test_library_reads_the_flag_of_a_stage_that_was_switched_off_and_on(lab, host):
    lab.lab.chain.power_cycle(3)
    assert until(lambda: host(3, 1, "get pos")[0][1:] == ["OK", "IDLE", "WR", "0"])


def test_rejections_are_those_that_the_library_expects(host):
    assert host(3, 1, "move nowhere 1")[0][1:] == ["RJ", "IDLE", "--", "BADCOMMAND"]
    assert host(3, 0, "set accel -5")[0][1:] == ["RJ", "IDLE", "--", "BADDATA"]
    assert host(3, 2, "get pos")[0][4] == "BADAXIS"
