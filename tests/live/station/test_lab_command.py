"""`ctr-station lab`: a process with simulated devices that the built-in drivers find and use in real time."""

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

from core.control.sensors import fuse_at
from station.config.loads import ConstantLoad
from station.devices.ati.netft import NetftSensors, NetftSettings, fetch_page
from station.devices.aurora.dialogue import AuroraSettings
from station.devices.aurora.protocol import framed
from station.devices.aurora.tracker import AuroraTracker
from station.devices.interfaces import Condition
from station.devices.kernel.stages import LineStages, Port
from station.devices.links.link import DatagramLink, Link, LinkError, SerialLink, reopen
from station.devices.zaber.chain import LineSettings
from station.devices.zaber.setup import StageSetup
from station.devices.zaber.stages import zaber_stages
from station.lab.aurora_coil import GENERATOR_POSE
from station.lab.config import LabConfig
from station.lab.endpoints import AddressInUse, PtyDeviceEnd, TcpDeviceEnd, UdpDeviceEnd
from station.lab.faults import LabFault
from station.lab.lab_server import LabServer
from station.lab.plant import Plant
from station.lab.simulated_netft import NetftFaults
from station.lab.wires import BUFFER_BYTES
from tests.harness.root import ROOT
from tests.harness.waiting import NET

PARK = (0.2, 1.2, -0.08)
LOAD = 0.3
#: Configuration of force sensors without noise and offset, so that a single sample equals the load.
SENSORS = """
[sensors]
force_noise = 0.0
moment_noise = 0.0
drift = 0.0
force_offset = 0.0
moment_offset = 0.0
"""


class Lab:
    """Process of `ctr-station lab` and its output."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout
        self.process = process
        self.where: dict[str, Any] = json.loads(process.stdout.readline())

    def end(self, number: int) -> tuple[int, bytes, bytes]:
        """Send a signal; return the exit status and the remaining output."""
        self.process.send_signal(number)
        out, err = self.process.communicate(timeout=NET)
        return self.process.returncode, out, err


@pytest.fixture
def start(write, tmp_path: Path, environment: dict[str, str]) -> Iterator[Callable[..., Lab]]:
    """Return a function that starts `ctr-station lab` with a load in a pose."""
    processes: list[subprocess.Popen[bytes]] = []
    lab = write(SENSORS, "quiet")
    joints = dict(zip(("outer_rotation", "inner_rotation", "inner_translation"), PARK, strict=True))
    park = ", ".join(f"{name} = {value}" for name, value in joints.items())

    def start(*options: str, fifo: bool = False) -> Lab:
        file = f'lab = "{lab}"\nfifo = {str(fifo).lower()}\npark = {{ {park} }}\n'
        config = write(file, "station")
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
def stages(paper) -> Callable[[str], LineStages[Any, Any]]:
    def stages(url: str) -> LineStages[Any, Any]:
        setups = [StageSetup.of(joint, number) for number, joint in enumerate(paper.joints, 1)]
        return zaber_stages(setups, [Port(SerialLink(url, 9600), (0, 1, 2))], LineSettings(deadline=2.0))

    return stages


def wait(reached: Callable[[], bool], poll: Callable[[], object], seconds: float = 40.0) -> bool:
    """Poll the devices every 2 ms until `reached` returns true; return whether it did in time."""
    give_up = time.monotonic() + seconds
    while not reached() and time.monotonic() < give_up:
        poll()
        time.sleep(0.002)
    return reached()


def is_cut(link: Link) -> bool:
    """Read everything that the other end of a connection has sent; return whether it has closed the connection."""
    try:
        link.read()
    except LinkError:
        return True
    return False


def gone(url: str) -> bool:
    """Return whether no program listens at the address."""
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
def test_drivers_find_every_device_of_the_lab_command_and_a_signal_ends_it_cleanly(
    start, stages, paper, options, prefix, number
):
    lab = start(*options)
    where = lab.where
    assert set(where) == {"zaber", "aurora", "netft"}
    assert where["zaber"].startswith(prefix)
    assert where["aurora"].startswith(prefix)
    assert [box["tube"] for box in where["netft"]] == ["inner", "outer"]

    motors = stages(where["zaber"])
    tracker = AuroraTracker(SerialLink(where["aurora"], 9600), AuroraSettings(frame_timeout=1.0), GENERATOR_POSE)
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
        assert wait(lambda: sensors.is_usable, poll), sensors.trouble(time.monotonic())

        assert [unit and unit.serial for unit in motors.axes.identities] == [1001, 1002, 1003]
        # After power-up a Zaber unit counts its position from 0, wherever it is.
        assert wait(lambda: bool(np.isfinite(motors.poll(time.monotonic()).positions).all()), poll)
        assert motors.poll(time.monotonic()).positions == pytest.approx(
            [s.position(0) for s in motors.axes.setups], abs=1e-9
        )
        assert [each["calibration"] for each in sensors.details().values()] == ["FT00001", "FT00002"]
        load = np.array([LOAD, 0.0, 0.0])
        fused = fuse_at(paper.robot(), np.array(PARK), sensors.poll(time.monotonic()).wrenches)
        assert fused.force == pytest.approx(load, abs=6e-3)  # tolerance: quantisation of two sensors, 3.9 mN each
        plant = Plant(paper.robot(), LabConfig().plant, np.random.default_rng(0), np.array(PARK))
        truth = plant.advance(np.array(PARK), load).truth
        assert np.mean(tips[-40:], axis=0) == pytest.approx(
            truth.tip, abs=0.1e-3
        )  # the mean of 40 frames has a noise of 0.1 mm / sqrt(40)

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
def test_second_program_can_use_the_lab_after_the_first_has_disconnected(start, stages, options):
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


def test_serial_line_of_the_lab_accepts_one_program_at_a_time(start, stages):
    lab = start()
    motors = stages(lab.where["zaber"])
    try:
        motors.connect(time.monotonic())
        wait(lambda: motors.axes.identities[0] is not None, lambda: motors.poll(time.monotonic()))
        part = urlsplit(lab.where["zaber"])
        with socket.create_connection((part.hostname, part.port), timeout=10.0) as second:
            assert second.recv(1) == b""  # the lab has closed the connection of the second program
        assert wait(lambda: motors.condition is Condition.CONNECTED, lambda: motors.poll(time.monotonic()))
    finally:
        motors.close()

    assert lab.end(signal.SIGINT)[0] == 0


def test_program_that_does_not_read_delays_no_other_device_of_the_lab(start):
    lab = start()
    part = urlsplit(lab.where["zaber"])
    with socket.create_connection((part.hostname, part.port)) as host:
        host.sendall(bytes((0, 60, 0, 0, 0, 0)) * 200)
        time.sleep(0.3)
        # The force sensor boxes answer during the whole test.
        assert fetch_page("127.0.0.1", urlsplit(lab.where["netft"][1]["page"]).port).serial == "FT00002"

    assert lab.end(signal.SIGTERM) == (0, b"", b"")


def may_be_real_time() -> bool:
    """Return whether the system grants real-time scheduling to a process of this user."""
    code = "import sys; from station.control.realtime import request_fifo; sys.exit(not request_fifo(40))"
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT).returncode == 0


def test_lab_requests_real_time_scheduling_and_reports_a_refusal(start):
    granted = may_be_real_time()
    lab = start("--pty", fifo=True)
    policy = os.sched_getscheduler(lab.process.pid) & ~os.SCHED_RESET_ON_FORK
    status, _, err = lab.end(signal.SIGTERM)

    assert status == 0
    assert (policy == os.SCHED_RR, b"real-time scheduling is refused" in err) == (granted, not granted)


def test_unread_terminal_never_blocks_the_lab():
    end = PtyDeviceEnd()
    try:
        for _ in range(1000):
            end.write(bytes(4096))  # far more bytes than the buffer of the pseudo-terminal has
        assert end.read() == b""
    finally:
        end.close()


@pytest.mark.parametrize("end", [PtyDeviceEnd, TcpDeviceEnd])
def test_lab_reads_a_bounded_part_of_a_flood_in_one_poll(end):
    end = end()
    link = SerialLink(end.name, 9600)
    try:
        end.read()  # wait until the lab has accepted the connection
        for _ in range(8):
            link.write(bytes(1000))
        parts: list[bytes] = []
        assert wait(lambda: sum(map(len, parts)) >= 8000, lambda: parts.append(end.read()))
        assert max(map(len, parts)) <= BUFFER_BYTES
    finally:
        link.close()
        end.close()


def test_force_sensor_box_reads_a_bounded_part_of_a_flood_in_one_poll():
    end = UdpDeviceEnd("127.0.0.1", 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        for _ in range(150):
            host.sendto(b"garbage", ("127.0.0.1", end.port))
    try:
        parts = [len(end.receive()) for _ in range(4)]
        assert parts == [64, 64, 22, 0]
    finally:
        end.close()


def test_lab_answers_its_programs_after_sigstop_and_sigcont(start, stages):
    """SIGSTOP has the same effect as a suspended computer or a debugger."""
    lab = start("--pty")
    motors = stages(lab.where["zaber"])
    try:
        motors.connect(time.monotonic())
        assert wait(lambda: motors.condition is Condition.CONNECTED, lambda: motors.poll(time.monotonic()))
        lab.process.send_signal(signal.SIGSTOP)
        assert wait(lambda: motors.condition is Condition.FAULT, lambda: motors.poll(time.monotonic()))
        lab.process.send_signal(signal.SIGCONT)
        motors.connect(time.monotonic())
        assert wait(lambda: motors.condition is Condition.CONNECTED, lambda: motors.poll(time.monotonic()))
    finally:
        motors.close()
    assert lab.end(signal.SIGTERM)[0] == 0


def test_lab_server_uses_the_configured_ports_of_the_force_sensor_boxes(paper):
    config = LabConfig()
    with LabServer(paper, config, 0, np.array(PARK)) as first:
        taken = int(urlsplit(first.endpoints["netft"][0]["rdt"]).port or 0)
        with pytest.raises(AddressInUse, match=str(taken)):
            LabServer(paper, config, 0, np.array(PARK), netft_port=taken)
    base = _two_free_ports()
    with LabServer(paper, config, 0, np.array(PARK), netft_port=base) as lab:
        assert [urlsplit(box["rdt"]).port for box in lab.endpoints["netft"]] == [base, base + 1]
        assert lab.lab.boxes[0].faults == NetftFaults()


@pytest.mark.parametrize("pty", [False, True])
def test_unplugged_device_of_the_lab_loses_its_port_and_is_found_again(paper, tmp_path: Path, pty):
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


def test_lab_command_reports_once_that_the_robot_cannot_follow_its_stages(paper, capsys):
    with LabServer(paper, LabConfig(), 0, np.array(PARK)) as lab:
        lab.lab.apply_load(ConstantLoad.model_construct(magnitude=1e6), 0.0)
        end = time.monotonic() + 0.05
        lab.run(lambda: time.monotonic() > end)

    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("the robot stays where it is: ")


def _two_free_ports() -> int:
    """Return the first of two consecutive free ports."""
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
