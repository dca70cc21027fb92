"""Drivers are found by name: the built-in drivers, and an installed driver that connects to a real server."""

import itertools
import socket
import threading
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from station.config.robots import load_robot
from station.config.strict import ConfigError
from station.control.clock import REAL_TIME_CLOCK
from station.devices import registry
from station.devices.config import BenchFile
from station.devices.interfaces import Condition, NotStopped, Severity, TipReading
from station.devices.registry import emergency_stop, find, plan, stages_latency
from station.docs.examples.line_stages.line_stages import open_stages
from station.service.station_file import load_station
from tests.harness.entry_points import install_entry_points
from tests.harness.imaginary_stages import DRIVER
from tests.harness.own_devices import OWN_DEVICES


@pytest.fixture
def install(tmp_path: Path, monkeypatch) -> Callable[..., None]:
    """Install a distribution whose entry points are drivers."""

    def install(entries: str, name: str = "my-bench") -> None:
        install_entry_points(tmp_path, {"ctr_station.devices": dict([entries.split(" = ")])}, name)
        monkeypatch.syspath_prepend(str(tmp_path))

    return install


def test_custom_tracker_is_found_and_tracks(install, paper):
    install("line-tracker = station.docs.examples.line_tracker.line_tracker:open_tracker")
    with socket.create_server(("127.0.0.1", 0)) as server:
        options = {"host": "127.0.0.1", "port": server.getsockname()[1], "latency": 0.024}
        tracker = find("tracker", "line-tracker")(options, paper)()
        try:
            tracker.connect(0.0)
            assert tracker.condition is Condition.CONNECTING
            visitor, _ = server.accept()
            visitor.sendall(b"1 10.0 -20.0 150.5\n2 10.5 -20.0 1")
            reading = _until(tracker, 1.0)
            assert (reading.frame, reading.time) == (1, pytest.approx(0.976))
            assert reading.position == pytest.approx([0.010, -0.020, 0.1505])
            assert tracker.condition is Condition.CONNECTED
            visitor.sendall(b"51.0\nnonsense\n3 nan 0 0\n")  # the second part of frame 2, then two malformed lines
            assert _until(tracker, 1.1).position == pytest.approx([0.0105, -0.020, 0.151])
            assert tracker.details()["malformed_lines"] == 2
            assert tracker.trouble(1.2) is None
            assert tracker.trouble(2.0).severity is Severity.HOLD
            visitor.close()
            assert _wait(lambda: tracker.poll(3.0) is None and tracker.condition is Condition.FAULT)
            assert "is gone" in str(tracker.trouble(3.0))

            tracker.connect(4.0)
            visitor, _ = server.accept()
            visitor.sendall(b"1 0 0 100\n")
            assert _until(tracker, 4.1).position == pytest.approx([0.0, 0.0, 0.1])
            visitor.close()
        finally:
            tracker.close()


def _until(tracker, now: float) -> TipReading:
    found: list[TipReading] = []
    assert _wait(lambda: (reading := tracker.poll(now)) is not None and not found.append(reading))
    return found[0]


def _wait(reached: Callable[[], bool]) -> bool:
    give_up = time.monotonic() + 5.0
    while time.monotonic() < give_up:
        if reached():
            return True
        time.sleep(0.002)
    return False


def test_unknown_driver_is_refused_with_the_known_names(install):
    install("line-tracker = station.docs.examples.line_tracker.line_tracker:open_tracker")
    with pytest.raises(
        ConfigError, match=r"devices.tracker.driver = 'polaris' is not one of aurora, stereo, line-tracker;.*"
    ):
        find("tracker", "polaris")
    with pytest.raises(
        ConfigError, match=r"devices.sensors.driver = 'aurora' is not one of netft, nidaq, line-tracker"
    ):
        find("sensors", "aurora")


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("no_such_module:open", "cannot be loaded: ModuleNotFoundError"),
        ("station.docs.examples.line_tracker.line_tracker:close", "cannot be loaded: AttributeError"),
        ("math:pi", r"is not a callable open\(options, robot\)"),
    ],
)
def test_driver_that_cannot_be_loaded_names_its_distribution(install, target, message):
    install(f"mine = {target}")
    with pytest.raises(ConfigError, match=rf"devices.tracker.driver = 'mine' \({target} of my-bench\) {message}"):
        find("tracker", "mine")


def test_device_of_another_kind_is_refused_and_closed(install, paper):
    install("line-tracker = station.docs.examples.line_tracker.line_tracker:open_tracker")
    with socket.create_server(("127.0.0.1", 0)) as server:
        options = {"host": "127.0.0.1", "port": server.getsockname()[1]}
        with pytest.raises(
            ConfigError, match=r"returned a LineTracker without command, home, ready, stop, which stages need"
        ):
            find("stages", "line-tracker")(options, paper)()
        visitor, _ = server.accept()
        with visitor:
            assert visitor.recv(1) == b""


def test_driver_name_installed_twice_is_refused(install):
    install("mine = math:sin")
    install("mine = math:cos", "other-bench")
    with pytest.raises(ConfigError, match=r"'mine' is installed more than once: .*math:cos of other-bench"):
        find("tracker", "mine")


def test_built_in_driver_takes_precedence(install, paper):
    install("aurora = no_such_module:open")
    with pytest.raises(ConfigError, match="'port' is missing"):
        find("tracker", "aurora")({}, paper)


def test_installed_driver_receives_its_options_and_the_robot(install, paper):
    install("echo = tests.unit.station.devices.test_registry:Given")
    given = find("tracker", "echo")({"gain": 2.0}, paper)()
    assert given.arguments == ({"gain": 2.0}, paper)


class Given:
    """A tracker that stores the arguments of its opening."""

    condition = Condition.CLOSED

    def __init__(self, *arguments: object) -> None:
        self.arguments = arguments

    def connect(self, now: float) -> None: ...
    def trouble(self, now: float) -> None: ...
    def details(self) -> dict[str, np.ndarray]: ...
    def poll(self, now: float) -> None: ...
    def close(self) -> None: ...


def test_custom_stages_provide_their_emergency_stop(install, paper):
    install("line-stages = station.docs.examples.line_stages.line_stages:open_stages")
    with socket.create_server(("127.0.0.1", 0)) as server:
        stop = emergency_stop({"driver": "line-stages", "host": "127.0.0.1", "port": server.getsockname()[1]}, paper)
        assert stop is not None
        results: list[str] = []
        stopping = threading.Thread(target=lambda: results.append(stop(REAL_TIME_CLOCK)))
        stopping.start()
        host, _ = server.accept()
        with host:
            assert host.recv(100) == b"stop\n"
            host.sendall(b"0 0 0\nstopped\n")
            stopping.join()
    assert results[0].startswith("3 stages at socket://127.0.0.1:")
    assert results[0].endswith("report that they have stopped")


def test_installed_driver_on_the_kernel_is_one_record(install, paper):
    install("imaginary = tests.harness.imaginary_stages:DRIVER")
    table = {"driver": "imaginary", "port": "loop://"}
    assert stages_latency(table, paper) == DRIVER.latency({"port": "loop://"}, paper)
    stop, clock = emergency_stop(table, paper), SimpleNamespace(now=itertools.count().__next__, sleep=lambda _: None)
    assert stop is not None
    with pytest.raises(NotStopped, match="the stages on loop:// cannot be commanded to stop"):
        stop(clock)
    stages = find("stages", "imaginary")({"port": "loop://"}, paper)()
    assert stages.condition is Condition.CLOSED
    stages.close()
    with pytest.raises(ConfigError, match=r"devices\.stages"):
        find("stages", "imaginary")({}, paper)()


def test_stages_without_an_emergency_stop_cause_a_warning_at_the_start(install, write):
    install("mute-stages = station.docs.examples.line_stages.line_stages:LineStages")
    path = write(OWN_DEVICES.replace('driver = "zaber"\nport = "/dev/ttyUSB0"', 'driver = "mute-stages"'))
    (warning,) = load_station(path).bench().warnings[:1]
    assert warning.startswith("nothing stops the stages of driver 'mute-stages' when the control process dies")
    assert "emergency stop" in warning


@pytest.mark.parametrize(
    ("stages", "expected"),
    [
        ({"driver": "zaber", "port": "a"}, (0.025, 0.012)),
        ({"driver": "cia402", "port": "a"}, (0.004, 0.00063)),
        ({"driver": "gcode", "dialect": "grbl", "port": "a"}, (0.010, 0.0232)),
        ({"driver": "gcode", "dialect": "grbl", "port": "a", "baud": 1_000_000}, (0.010, 0.0265)),
    ],
)
def test_built_in_driver_gives_the_latency_of_its_options(stages, expected, paper):
    assert stages_latency(stages, paper) == pytest.approx(expected, abs=1e-4)


def test_zaber_chain_has_an_interval_for_each_axis_and_the_longest_line_counts(paper):
    assert stages_latency({"driver": "zaber", "port": "a"}, load_robot("three_tubes")) == (0.0438, 0.012)
    ports = dict(zip([joint.name for joint in paper.joints], "aab", strict=True))
    joints = {name: {"port": port, "device": i} for i, (name, port) in enumerate(ports.items(), 1)}
    assert stages_latency({"driver": "zaber", "joints": joints}, paper) == (0.0188, 0.012)


OWN_STAGES = {"driver": "line-stages", "host": "127.0.0.1", "port": 1}


def test_custom_stages_may_give_their_latency(install, paper, monkeypatch):
    install("line-stages = station.docs.examples.line_stages.line_stages:open_stages")
    assert stages_latency(OWN_STAGES, paper) == (0.025, 0.012)  # as T-series stages on one line
    monkeypatch.setattr(
        open_stages, "latency", lambda options, robot: (1e-3 * options["port"], 2e-3 * len(robot.joints)), raising=False
    )
    assert stages_latency(OWN_STAGES, paper) == (0.001, 0.006)


@pytest.mark.parametrize("latency", [lambda options, robot: (0.01, 2.0), lambda options, robot: 0.01, "10 ms"])
def test_wrong_latency_of_custom_stages_names_their_driver(latency, install, paper, monkeypatch):
    install("line-stages = station.docs.examples.line_stages.line_stages:open_stages")
    monkeypatch.setattr(open_stages, "latency", latency, raising=False)
    with pytest.raises(ConfigError, match=r"driver = 'line-stages' .*: its latency"):
        stages_latency(OWN_STAGES, paper)


README = Path(registry.__file__).with_name("README.md").read_text(encoding="utf-8")


def test_bench_of_the_readme_is_valid(paper):
    text = next(part for part in README.split("```toml\n")[1:] if part.startswith("[devices.stages]")).split("```")[0]
    bench = BenchFile(**tomllib.loads(text)["devices"])
    assert set(plan(bench, paper)) == {"stages", "tracker", "sensors"}
