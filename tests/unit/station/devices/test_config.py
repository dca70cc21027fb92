"""Table `[devices]` of a station file: accepted and refused values, before any device is opened."""

import math
import tomllib

import numpy as np
import pytest

from station.config.strict import ConfigError, Strict, check
from station.devices.ati.netft import NetftSettings
from station.devices.ati.nidaq import NidaqFile
from station.devices.aurora.tracker import AuroraFile
from station.devices.cia402.setup import Cia402File
from station.devices.config import BenchFile, DevicesFile, Mount, mounted, transport
from station.devices.gcode.setup import GcodeFile
from station.devices.interfaces import WrenchReading
from station.devices.registry import plan
from station.devices.stereo.tracker import StereoFile
from station.devices.zaber.setup import ZaberFile
from station.devices.zaber_ascii.setup import AsciiFile
from station.service.station_file import ClockFile


class File(Strict):
    devices: DevicesFile = "virtual"


BENCH = """
[devices.stages]
driver = "zaber"
port = "/dev/ttyUSB0"
joints.outer_rotation = { device = 1, serial = 12345, home_at = 0.5 }
joints.inner_rotation = { device = 2, backwards = true, home_speed = 0.1 }
joints.inner_translation = { device = 3, device_id = 4152 }

[devices.tracker]
driver = "aurora"
port = "/dev/ttyUSB1"
tool = "3A5C1D00"
latency = 0.030
coil_to_tip = 0.004
mount = { position = [0.1, 0.0, -0.2], rotation_vector = [3.141592653589793, 0.0, 0.0] }

[devices.sensors]
driver = "netft"
ranges = [9.0, 9.0, 9.0, 0.125, 0.125, 0.125]
tubes.inner = { host = "192.168.1.11", serial = "FT12345", mount.rotation_vector = [0.0, 0.0, 0.5] }
tubes.outer = { host = "192.168.1.12", rdt_port = 49153, http_port = 8080 }
"""


def read(text: str) -> BenchFile | str:
    return check(File, tomllib.loads(text), "bench.toml").devices


def test_missing_devices_table_selects_the_virtual_lab():
    assert read("") == "virtual"
    assert read('devices = "virtual"') == "virtual"


def test_whole_bench_is_parsed_without_opening_a_device(paper):
    bench = read(BENCH)
    assert isinstance(bench, BenchFile)
    assert set(plan(bench, paper)) == {"stages", "tracker", "sensors"}


def test_stages_on_separate_ports_may_have_the_same_number(paper):
    own = "\n".join(
        f'joints.{joint.name} = {{ device = 1, port = "/dev/ttyUSB{k}" }}' for k, joint in enumerate(paper.joints)
    )
    text = BENCH.replace(BENCH[BENCH.index("port =") : BENCH.index("[devices.tracker]")], own + "\n\n")
    bench = read(text)
    assert isinstance(bench, BenchFile)
    plan(bench, paper)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (BENCH, 'devices = "real"', "devices = 'real': expected 'virtual', or a table of stages"),
        (BENCH, "devices = 5", "devices = 5: expected 'virtual'"),
        ("[devices.tracker]", "[devices.camera]", "unknown key 'devices.camera'"),
        ('driver = "zaber"', "", "devices.stages = .*'driver' is missing"),
        ('driver = "zaber"', 'driver = "newport"', r"devices.stages.driver = 'newport' is not one of zaber"),
        ('port = "/dev/ttyUSB0"', "", r"devices.stages.port is missing: outer_rotation has no port"),
        ('port = "/dev/ttyUSB0"', 'prot = "/dev/ttyUSB0"', r"devices.stages: unknown key 'prot'"),
        (
            "joints.inner_rotation",
            "joints.elbow",
            r"devices.stages.joints.elbow: the robot has no such part; it has outer_",
        ),
        (
            "joints.inner_rotation = { device = 2, backwards = true, home_speed = 0.1 }",
            "",
            r"devices.stages.joints.inner_rotation is missing",
        ),
        ("device = 2", "device = 1", r"joints.inner_rotation.device = 1: outer_rotation has the same axis"),
        ("device = 2", "device = 255", r"joints.inner_rotation.device = 255: .*254"),
        ("home_at = 0.5", "home_at = 7.0", r"devices.stages.joints.outer_rotation: home count"),
        ('host = "192.168.1.11", ', "", r"devices.sensors: 'tubes.inner.host' is missing"),
        (
            'host = "192.168.1.12", rdt_port = 49153',
            'host = "192.168.1.11"',
            r"devices.sensors.tubes.outer.host = '192.168.1.11': inner has the same box",
        ),
        (
            "tubes.outer",
            "tubes.middle",
            r"devices.sensors.tubes.middle: the robot has no such part; it has inner, outer",
        ),
    ],
)
def test_invalid_value_is_refused_with_key_value_and_expectation(paper, old, new, message):
    text = BENCH.replace(old, new)
    assert text != BENCH

    def use() -> None:
        bench = read(text)
        assert isinstance(bench, BenchFile)
        plan(bench, paper)

    with pytest.raises(ConfigError, match=message):
        use()


def test_mount_rotation_matches_its_rotation_vector():
    quarter = Mount(rotation_vector=(0.0, 0.0, math.pi / 2.0)).rotation
    assert quarter @ np.array([1.0, 0.0, 0.0]) == pytest.approx([0.0, 1.0, 0.0])
    assert Mount().rotation == pytest.approx(np.eye(3))


@pytest.mark.parametrize("seed", range(2))
def test_transformed_wrench_matches_the_force_at_the_same_point(seed):
    """The sensor's wrench of a force, transformed to the tube's end, must equal the wrench of this force there."""
    random = np.random.default_rng(seed)
    position, vector, point, force = random.uniform(-0.1, 0.1, 3), random.uniform(-2, 2, 3), *random.normal(size=(2, 3))
    mount = Mount(position=tuple(position.tolist()), rotation_vector=tuple(vector.tolist()))
    turn = _by_series(vector)
    own_force, own_point = turn.T @ force, turn.T @ (point - position)
    felt = np.concatenate([own_force, np.cross(own_point, own_force)])

    assert transport(mount) @ felt == pytest.approx(np.concatenate([force, np.cross(point, force)]), abs=1e-12)


def _by_series(vector: np.ndarray) -> np.ndarray:
    """Return the exponential of the cross product's matrix, term by term."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    term = total = np.eye(3)
    for k in range(1, 40):
        term = term @ cross / k
        total = total + term
    return total


class Steady:
    """Sensors with constant readings."""

    def __init__(self, wrenches: np.ndarray, usable: bool = True) -> None:
        self.reading = WrenchReading(1.5, wrenches, usable)

    def poll(self, now: float) -> WrenchReading:
        return self.reading


def test_each_sensor_is_transformed_by_its_mount_only():
    sensors = Steady(np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]] * 2), usable=False)
    reading = mounted(sensors, [Mount(rotation_vector=(0.0, 0.0, math.pi / 2)), Mount(position=(0.0, 0.0, 0.02))]).poll(
        2.0
    )

    assert reading.wrenches[0] == pytest.approx([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    assert reading.wrenches[1] == pytest.approx([1.0, 0.0, 0.0, 0.0, 0.02, 0.0])
    assert (reading.time, reading.usable) == (1.5, False)


def test_sensors_without_a_mount_are_returned_unchanged():
    sensors = Steady(np.zeros((2, 6)))
    assert mounted(sensors, [Mount(), Mount()]) is sensors


UNDER = BENCH.replace("tubes.inner = {", 'at = "robot"\nrobot = {').split("tubes.outer")[0]


def test_bench_may_have_one_force_sensor_under_the_robot_or_on_one_tube(paper):
    for text, at in ((UNDER, "robot"), (BENCH.replace("tubes.outer", 'at = "inner"\n#'), "inner")):
        bench = read(text)
        assert bench.sensors_at == at
        assert bench.present.sensors == (at == "robot")  # a sensor on one tube does not measure the whole load
        robot = paper.sensed_at(at, "devices.sensors.at")
        assert robot.sensor_names == (at,)
        assert set(plan(bench, robot)) == {"stages", "tracker", "sensors"}
        assert paper.sensor_names == ("inner", "outer")


@pytest.mark.parametrize(
    ("text", "at", "message"),
    [
        (BENCH, "robot", r"devices.sensors.tubes.inner: with at = 'robot' .* describe it in \[devices.sensors.robot\]"),
        (UNDER.split("robot = {")[0], "robot", r"devices.sensors.robot is missing: with at = 'robot'"),
        (UNDER, "tubes", r"devices.sensors.robot: a sensor under the whole robot needs at = 'robot'"),
        (BENCH, "inner", r"devices.sensors.tubes.outer: the robot has no such part; it has inner"),
        (BENCH.replace("tubes.outer", "#"), "tubes", r"tubes.outer is missing: .* set at = 'robot' or the tube's name"),
        (BENCH, "middle", r"devices.sensors.at = 'middle': expected 'tubes' .* 'robot' .* inner, outer"),
    ],
)
def test_force_sensors_that_do_not_fit_their_place_are_refused(paper, text, at, message):
    with pytest.raises(ConfigError, match=message):
        plan(read(text), paper.sensed_at(at, "devices.sensors.at"))


@pytest.mark.parametrize(
    ("model", "key", "most"),
    [
        *((model, "deadline", 2.0) for model in (ZaberFile, AsciiFile, GcodeFile, Cia402File)),
        *((model, "stale_after", 2.0) for model in (AuroraFile, StereoFile, NetftSettings, NidaqFile)),
        *((model, "latency", 1.0) for model in (AuroraFile, StereoFile, NetftSettings)),
        (ClockFile, "patience", 2.0),
    ],
)
def test_no_file_lets_a_device_be_silent_or_late_for_longer(model: type[Strict], key: str, most: float) -> None:
    with pytest.raises(ConfigError, match=f"{key}.* {most:g}"):
        check(model, {key: 1.01 * most}, "file")
