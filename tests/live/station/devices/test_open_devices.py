"""The built-in drivers open a lab's real endpoints as configured; if one cannot be opened, none stays open."""

import math
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from core.control.sensors import fuse_at
from station.config.loads import ConstantLoad
from station.devices.config import BenchFile
from station.devices.interfaces import Condition, Devices
from station.devices.links.link import DatagramLink, SerialLink
from station.devices.registry import OpenError, open_devices
from station.lab.config import BaseSensorConfig, LabConfig, TrackerConfig
from station.lab.faults import LabFault
from station.lab.lab_server import LabServer
from tests.harness.running_lab import running
from tests.harness.waiting import until

PARK = np.array([0.2, 1.2, -0.08])
LOAD = np.array([0.3, 0.0, 0.0])
QUIET = BaseSensorConfig(
    force_noise=0.0, moment_noise=0.0, drift=0.0, moment_drift=0.0, force_offset=0.0, moment_offset=0.0
)
CONFIG = LabConfig(tracker=TrackerConfig(noise=0.0), sensors=QUIET)


def bench_of(lab: LabServer) -> dict[str, Any]:
    """Return the devices of a station file for a lab's endpoints."""
    tubes = {
        box["tube"]: {
            "host": "127.0.0.1",
            "rdt_port": urlsplit(box["rdt"]).port,
            "http_port": urlsplit(box["page"]).port,
            "serial": f"FT{number:05}",
        }
        for number, box in enumerate(lab.endpoints["netft"], 1)
    }
    return {
        "stages": {"driver": "zaber", "port": lab.endpoints["zaber"], "deadline": 2.0},
        "tracker": {
            "driver": "aurora",
            "port": lab.endpoints["aurora"],
            "mount": {"position": [0.0, 0.0, -0.2], "rotation_vector": [math.pi, 0.0, 0.0]},
        },
        "sensors": {"driver": "netft", "tubes": tubes, "stale_after": 1.0},
    }


def come_up(devices: Devices, seconds: float = 30.0) -> list[np.ndarray]:
    """Connect, poll until all devices are connected, and return the tips measured from then on."""
    start = time.monotonic()
    tips: list[np.ndarray] = []
    for device in (devices.stages, devices.tracker, devices.sensors):
        device.connect(start)
    while len(tips) < 20 and (now := time.monotonic()) < start + seconds:
        devices.stages.poll(now)
        frame, sample = devices.tracker.poll(now), devices.sensors.poll(now)
        up = devices.stages.condition is Condition.CONNECTED and devices.sensors.condition is Condition.CONNECTED
        if frame is not None and sample.usable and up:
            tips.append(frame.position)
        time.sleep(0.002)
    return tips


def is_free(lab: LabServer) -> bool:
    """Return whether every endpoint can be opened."""
    for url in (lab.endpoints["zaber"], lab.endpoints["aurora"]):
        SerialLink(url, 9600).close()
    for box in lab.endpoints["netft"]:
        DatagramLink("127.0.0.1", urlsplit(box["rdt"]).port or 0).close()
    return True


def close(devices: Devices) -> None:
    for device in (devices.stages, devices.tracker, devices.sensors):
        device.close()


def test_bench_connects_from_its_file_and_measures_the_true_tip(paper):
    turned = {"rotation_vector": [0.0, 0.0, 0.5], "position": [0.0, 0.0, 0.01]}
    with running(LabServer(paper, CONFIG, 0, PARK, homed=True)) as lab:
        lab.lab.apply_load(ConstantLoad(magnitude=0.3), 0.0)
        options = bench_of(lab)
        options["sensors"]["tubes"]["outer"]["mount"] = turned
        devices = open_devices(BenchFile(**options), paper)
        try:
            tips = come_up(devices)
            assert len(tips) == 20, [device.trouble(time.monotonic()) for device in vars(devices).values()]
            assert devices.stages.ready
            now = time.monotonic()
            assert devices.stages.poll(now).positions == pytest.approx(PARK, abs=2e-6)
            assert np.mean(tips, axis=0) == pytest.approx(lab.lab.truth.tip, abs=1e-5)
            wrenches = devices.sensors.poll(now).wrenches
        finally:
            close(devices)
        assert is_free(lab)
    # The outer sensor is rotated about its tube and 10 mm ahead of the tube's end; the inverse transform gives the
    # load.
    c, s = math.cos(-0.5), math.sin(-0.5)
    back = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    force, moment = wrenches[1][:3], wrenches[1][3:] - np.cross([0.0, 0.0, 0.01], wrenches[1][:3])
    straight = np.array([wrenches[0], np.concatenate([back @ force, back @ moment])])
    assert fuse_at(paper.robot(), PARK, straight).force == pytest.approx(LOAD, abs=6e-3)
    assert np.abs(fuse_at(paper.robot(), PARK, wrenches).force - LOAD).max() > 0.01


def test_device_that_returns_as_another_terminal_is_connected_again(paper, tmp_path: Path):
    with running(LabServer(paper, CONFIG, 0, PARK, pty=True, homed=True, folder=tmp_path)) as lab:
        devices = open_devices(BenchFile(**bench_of(lab)), paper)
        try:
            assert len(come_up(devices)) == 20
            lab.lab.inject([LabFault(kind="disconnect", device=name) for name in ("stages", "tracker")], 0.0)
            give_up = time.monotonic() + 10.0
            lost = (devices.stages, devices.tracker)
            while any(d.condition is not Condition.FAULT for d in lost) and time.monotonic() < give_up:
                devices.stages.poll(time.monotonic())
                devices.tracker.poll(time.monotonic())
                time.sleep(0.002)
            assert [device.condition for device in lost] == [Condition.FAULT] * 2
            for device in lost:  # the devices are still unplugged
                device.connect(time.monotonic())
                assert device.condition is Condition.FAULT
                assert "cannot be opened" in str(device.trouble(time.monotonic()))
            links = [Path(lab.endpoints[name]) for name in ("zaber", "aurora")]
            before = [link.lstat().st_ctime_ns for link in links]
            lab.lab.inject((), 0.0)
            until(lambda: all(_is_new(*pair) for pair in zip(links, before, strict=True)))  # plugged in again
            assert len(come_up(devices)) == 20, [device.trouble(time.monotonic()) for device in lost]
            assert not devices.stages.ready  # the stages must be homed again
        finally:
            close(devices)


def _is_new(link: Path, before: int) -> bool:
    """Return whether a symbolic link was made again after `before` [ns]."""
    try:
        return link.lstat().st_ctime_ns != before
    except FileNotFoundError:  # it is being replaced
        return False


def no_tracker(bench: dict[str, Any]) -> str:
    bench["tracker"]["port"] = "/dev/none"
    return r"devices.tracker: /dev/none cannot be opened: .*plugged in"


def one_port_for_two(bench: dict[str, Any]) -> str:
    bench["tracker"]["port"] = bench["stages"]["port"]
    return r"devices.tracker: .* this is the present process: two devices cannot use the same port"


def exchanged_sensors(bench: dict[str, Any]) -> str:
    inner, outer = bench["sensors"]["tubes"].values()
    inner["serial"], outer["serial"] = outer["serial"], inner["serial"]
    return r"devices.sensors: .* has calibration 'FT00001', expected 'FT00002'; .*exchanged"


def no_box(bench: dict[str, Any]) -> str:
    bench["sensors"]["tubes"]["outer"]["http_port"] = 9
    return r"devices.sensors: http://127.0.0.1:9/netftapi2.xml does not answer"


@pytest.mark.parametrize("spoil", [no_tracker, one_port_for_two, exchanged_sensors, no_box])
def test_failure_of_one_device_closes_all_devices(paper, spoil):
    with running(LabServer(paper, CONFIG, 0, PARK)) as lab:
        bench = bench_of(lab)
        options = spoil(bench)
        with pytest.raises(OpenError, match=options):
            open_devices(BenchFile(**bench), paper)
        assert is_free(lab)
