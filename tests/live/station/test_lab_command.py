"""`ctr-station lab`: a process whose simulated devices the project's own drivers find and use, in real time."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from core.control.force_fusion import fuse_at
from station.devices.aurora.protocol import framed
from station.devices.aurora.settings import AuroraSettings
from station.devices.aurora.tracker import AuroraTracker
from station.devices.links.link import DatagramLink, Link, LinkError, SerialLink, reopen
from station.devices.netft.sensors import NetftSensors, NetftSettings, fetch_page
from station.devices.zaber.chain import Line
from station.devices.zaber.setup import Port, StageSetup
from station.devices.zaber.stages import Condition, ZaberStages
from station.lab.aurora.coil import MOUNT
from station.lab.config import LabConfig
from station.lab.faults import LabFault
from station.lab.lab_server import LabServer
from station.lab.loads import ConstantLoad
from station.lab.netft.simulated import NetftFaults
from station.lab.netft.wire import AddressTaken
from station.lab.plant import Plant
from tests.harness.waiting import NET

PARK = (0.2, 1.2, -0.08)
LOAD = 0.3
#: Force sensors without noise and offset, so that a single sample is the load.
SENSORS = """
[sensors]
force_noise = 0.0
moment_noise = 0.0
drift = 0.0
force_offset = 0.0
moment_offset = 0.0
"""


class Lab:
    """The process and what it has said."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout
        self.process = process
        self.where: dict[str, Any] = json.loads(process.stdout.readline())

    def end(self, number: int) -> tuple[int, bytes, bytes]:
        """Send it a signal: status, and what else was said."""
        self.process.send_signal(number)
        out, err = self.process.communicate(timeout=NET)
        return self.process.returncode, out, err


@pytest.fixture
def start(write, tmp_path: Path, environment: dict[str, str]) -> Iterator[Callable[..., Lab]]:
    """Start `ctr-station lab` with that load at that pose."""
    processes: list[subprocess.Popen[bytes]] = []
    lab = write(SENSORS, "quiet")
    joints = dict(zip(("outer_rotation", "inner_rotation", "inner_translation"), PARK, strict=True))
    park = ", ".join(f"{name} = {value}" for name, value in joints.items())
    config = write(f'lab = "{lab}"\npark = {{ {park} }}\n', "station")

    def start(*options: str) -> Lab:
        command = [sys.executable, "-m", "station", "lab", "--config", str(config), "--load", str(LOAD), *options]
        pipe = subprocess.PIPE
        processes.append(subprocess.Popen(command, stdout=pipe, stderr=pipe, cwd=tmp_path, env=environment))
        return Lab(processes[-1])

    yield start
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def stages(paper) -> Callable[[str], ZaberStages]:
    def stages(url: str) -> ZaberStages:
        setups = [StageSetup.of(joint, number) for number, joint in enumerate(paper.joints, 1)]
        return ZaberStages(setups, [Port(SerialLink(url, 9600), (0, 1, 2))], Line(deadline=2.0))

    return stages


def wait(reached: Callable[[], bool], poll: Callable[[], object], seconds: float = 40.0) -> bool:
    """Poll every 2 ms until it is reached; false if it never was."""
    give_up = time.monotonic() + seconds
    while not reached() and time.monotonic() < give_up:
        poll()
        time.sleep(0.002)
    return reached()


def is_cut(link: Link) -> bool:
    """Whether the other end has gone, once all that it had said is read."""
    try:
        link.read()
    except LinkError:
        return True
    return False


def gone(url: str) -> bool:
    """Whether nobody listens there any more."""
    part = urlsplit(url)
    try:
        socket.create_connection((part.hostname, part.port), timeout=1.0).close()
    except OSError:
        return True
    return False


@pytest.mark.parametrize(
    ("options", "prefix", "number"),
    [((), "socket://127.0.0.1:", signal.SIGINT), (("--pty",), "/dev/pts/", signal.SIGTERM)],
    ids=["sockets and Ctrl-C", "terminals and SIGTERM"],
)
def test_the_drivers_find_every_device_and_a_signal_ends_it_cleanly(start, stages, paper, options, prefix, number):
    lab = start(*options)
    where = lab.where
    assert set(where) == {"zaber", "aurora", "netft"}
    assert where["zaber"].startswith(prefix)
    assert where["aurora"].startswith(prefix)
    assert [box["tube"] for box in where["netft"]] == ["inner", "outer"]

    motors = stages(where["zaber"])
    tracker = AuroraTracker(SerialLink(where["aurora"], 9600), AuroraSettings(frame_timeout=1.0), MOUNT)
    pages = [fetch_page("127.0.0.1", urlsplit(box["page"]).port) for box in where["netft"]]
    links = [DatagramLink("127.0.0.1", urlsplit(box["rdt"]).port) for box in where["netft"]]
    sensors = NetftSensors(links, pages, NetftSettings(stale_after=1.0))
    tips: list[np.ndarray] = []

    def poll() -> None:
        now = time.monotonic()
        motors.poll(now)
        if (frame := tracker.poll(now)) is not None:
            tips.append(frame.position)
        sensors.poll(now)

    try:
        motors.connect(time.monotonic())
        sensors.start(time.monotonic())
        assert wait(lambda: motors.condition is not Condition.CONNECTING, poll)
        assert motors.condition is Condition.CONNECTED, motors.problem
        assert wait(lambda: len(tips) >= 40, poll), tracker.report(time.monotonic())
        assert wait(lambda: sensors.is_usable, poll), sensors.complaint()

        assert [unit and unit.serial for unit in motors.identities] == [1001, 1002, 1003]
        # Just switched on: the units count from 0 where they stand, wherever that is.
        assert wait(lambda: bool(np.isfinite(motors.poll(time.monotonic()).positions).all()), poll)
        assert motors.poll(time.monotonic()).positions == pytest.approx(
            [s.position(0) for s in motors.setups], abs=1e-9
        )
        assert [page.serial for page in sensors.pages] == ["FT00001", "FT00002"]
        load = np.array([LOAD, 0.0, 0.0])
        fused = fuse_at(paper.robot(), np.array(PARK), sensors.poll(time.monotonic()).wrenches)
        assert fused.force == pytest.approx(load, abs=6e-3)  # two sensors' quantisation of 3.9 mN
        plant = Plant(paper.robot(), LabConfig().plant, np.random.default_rng(0), np.array(PARK))
        truth = plant.advance(np.array(PARK), load).truth
        assert np.mean(tips[-40:], axis=0) == pytest.approx(truth.tip, abs=0.1e-3)  # noise 0.1 mm / sqrt(40)

        assert lab.end(number) == (0, b"", b"")
        assert wait(lambda: is_cut(motors.ports[0].link), lambda: None, 5.0)
        if not options:
            assert gone(where["aurora"])
        assert gone(where["netft"][0]["page"])
    finally:
        motors.close()
        tracker.close()
        sensors.close()


@pytest.mark.parametrize("options", [(), ("--pty",)])
def test_another_program_can_connect_when_the_first_has_left(start, stages, options):
    lab = start(*options)
    for _ in range(3):
        motors = stages(lab.where["zaber"])
        try:
            motors.connect(time.monotonic())
            assert wait(
                lambda motors=motors: motors.condition is not Condition.CONNECTING,
                lambda motors=motors: motors.poll(time.monotonic()),
            )
            assert motors.condition is Condition.CONNECTED, motors.problem
        finally:
            motors.close()

    assert lab.end(signal.SIGINT)[0] == 0


def test_a_line_is_one_programs_at_a_time(start, stages):
    lab = start()
    motors = stages(lab.where["zaber"])
    try:
        motors.connect(time.monotonic())
        wait(lambda: motors.identities[0] is not None, lambda: motors.poll(time.monotonic()))
        part = urlsplit(lab.where["zaber"])
        with socket.create_connection((part.hostname, part.port), timeout=10.0) as second:
            assert second.recv(1) == b""  # sent away
        assert wait(lambda: motors.condition is Condition.CONNECTED, lambda: motors.poll(time.monotonic()))
    finally:
        motors.close()

    assert lab.end(signal.SIGINT)[0] == 0


def test_a_host_that_does_not_read_holds_nothing_up(start):
    lab = start()
    part = urlsplit(lab.where["zaber"])
    with socket.create_connection((part.hostname, part.port)) as host:
        host.sendall(bytes((0, 60, 0, 0, 0, 0)) * 200)
        time.sleep(0.3)
        # all the while the boxes answer
        assert fetch_page("127.0.0.1", urlsplit(lab.where["netft"][1]["page"]).port).serial == "FT00002"

    assert lab.end(signal.SIGTERM) == (0, b"", b"")


def test_the_boxes_can_be_given_their_ports(paper):
    config = LabConfig()
    with LabServer(paper, config, 0, np.array(PARK)) as first:
        taken = int(urlsplit(first.endpoints["netft"][0]["rdt"]).port or 0)
        with pytest.raises(AddressTaken, match=str(taken)):
            LabServer(paper, config, 0, np.array(PARK), netft_port=taken)
    base = _two_free_ports()
    with LabServer(paper, config, 0, np.array(PARK), netft_port=base) as lab:
        assert [urlsplit(box["rdt"]).port for box in lab.endpoints["netft"]] == [base, base + 1]
        assert lab.lab.boxes[0].faults == NetftFaults()


@pytest.mark.parametrize("pty", [False, True])
def test_a_pulled_cable_is_a_dead_port_and_the_same_device_comes_back(paper, tmp_path: Path, pty):
    pulled = LabFault(kind="disconnect", device="tracker")
    with LabServer(paper, LabConfig(), 0, np.array(PARK), pty=pty, folder=tmp_path) as lab:

        def run() -> None:
            end = time.monotonic() + 0.05
            lab.run(lambda: time.monotonic() > end)

        link, other = SerialLink(lab.endpoints["aurora"], 9600), SerialLink(lab.endpoints["zaber"], 9600)
        try:
            run()
            lab.lab.inject((pulled,), 0.0)
            run()
            assert wait(lambda: is_cut(link), lambda: None, 5.0)
            assert not is_cut(other)
            with pytest.raises(LinkError):
                reopen(link)
            lab.lab.inject((), 0.0)
            run()
            reopen(link)
            link.write(framed("INIT:"))
            heard = bytearray()
            assert wait(lambda: heard == framed("OKAY"), lambda: (run(), heard.extend(link.read())), 5.0)
        finally:
            link.close()
            other.close()


def test_a_robot_that_cannot_follow_is_reported_once(paper, capsys):
    with LabServer(paper, LabConfig(), 0, np.array(PARK)) as lab:
        lab.lab.apply_load(ConstantLoad.model_construct(magnitude=1e6), 0.0)
        end = time.monotonic() + 0.05
        lab.run(lambda: time.monotonic() > end)

    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1
    assert told[0].startswith("the robot stays where it is: ")


def _two_free_ports() -> int:
    """The first of two neighbours that nobody has."""
    for port in range(30000 + os.getpid() % 1000, 60000, 2):
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as two,
        ):
            try:
                one.bind(("127.0.0.1", port))
                two.bind(("127.0.0.1", port + 1))
            except OSError:
                continue
            return port
    raise AssertionError("no two free ports")
