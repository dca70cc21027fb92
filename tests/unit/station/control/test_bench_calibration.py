"""Numbers of every file of a calibration have plausible ranges; a file beyond them is refused with key and value."""

import math
import os
import re
import shutil
import tomllib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from core.calibration.rigid_transform import rotation_from_vector
from core.control.sensors import Sensors
from core.control.tip_residual import TipResidual, inputs_of
from core.errors import CtrError
from core.model.statics import Statics
from station.calibration.files import write_described, write_latency
from station.config.controllers import Present, default_controller
from station.config.robots import RobotFile, load_robot
from station.config.strict import ConfigError, toml_lines
from station.control.bench_calibration import BenchCalibration, LatencyFile, RegistrationFile, SensorsFile, ViewsFile
from station.control.calibrated_robot import (
    CAMERAS_FILE,
    KINDS,
    LATENCY_FILE,
    REGISTRATION_FILE,
    RESIDUAL_FILE,
    ROBOT_FILE,
    SENSORS_FILE,
)
from station.control.residual_file import ResidualFile, write_residual
from station.devices.cameras import CameraFile
from tests.harness.root import ROOT

KEPT = ROOT / "tests" / "harness" / "calibrated_bench"
MODELS = {
    REGISTRATION_FILE: RegistrationFile, SENSORS_FILE: SensorsFile, ROBOT_FILE: RobotFile, CAMERAS_FILE: ViewsFile,
    RESIDUAL_FILE: ResidualFile, LATENCY_FILE: LatencyFile,
}  # fmt: skip
DESCRIBED = load_robot(str(KEPT / "robot.toml"))
DEVICE = "/dev/v4l/by-id/left"
FITTED = {"left": CameraFile(device=DEVICE, width=640, height=480)}
CAMERAS = f"""
robot = "mine"
made = "here"
[board]
square = 0.02
[cameras.left]
device = "{DEVICE}"
width = 640
height = 480
[cameras.left.lens]
focal = [642.1, 641.5]
centre = [318.0, 243.0]
distortion = [-0.1, 0.05, 0.001, -0.001, 0.0]
[cameras.left.pose]
position = [0.02, -0.4, 0.13]
rotation_vector = [-1.2, -1.2, -1.2]
"""

#: Number of random examples.
EXAMPLES = int(os.environ.get("EXAMPLES", "20"))

Document = dict[str, Any]
Key = tuple[str | int, ...]


def write_calibration(folder: Path) -> Path:
    """Write a complete calibration of the kept robot with one camera."""
    shutil.copytree(KEPT / "calibration", folder)
    (folder / CAMERAS_FILE).write_text(CAMERAS, encoding="utf-8")
    write_described(folder, DESCRIBED)
    write_latency(folder, 0.003, "here")
    inputs = inputs_of(DESCRIBED.robot())
    d = len(inputs.table)
    learned = TipResidual(inputs, np.eye(3), np.ones(d), np.zeros((2, d)), np.zeros((2, 3)), np.eye(2), 0.9, 1e-3)
    write_residual(folder / RESIDUAL_FILE, DESCRIBED.robot(), learned, 20, "here")
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_calibration(tmp_path_factory.mktemp("kept") / "calibration")


def numbers(value: Any, at: Key = ()) -> Iterator[tuple[Key, float]]:
    """Yield each number of a file with its key."""
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from numbers(one, (*at, key))
    elif isinstance(value, list):
        for index, one in enumerate(value):
            yield from numbers(one, (*at, index))
    elif isinstance(value, int | float) and at != ("format",):
        yield at, value


def with_number(value: Any, at: Key, new: float) -> Any:
    if not at:
        return new
    if isinstance(value, Mapping):
        return {key: with_number(one, at[1:], new) if key == at[0] else one for key, one in value.items()}
    return [with_number(one, at[1:], new) if index == at[0] else one for index, one in enumerate(value)]


def unbounded(schema: Any, at: str) -> Iterator[str]:
    """Yield the keys of a JSON schema whose numbers lack a lower or an upper bound."""
    if isinstance(schema, list):
        for one in schema:
            yield from unbounded(one, at)
    if not isinstance(schema, Mapping):
        return
    if schema.get("type") in ("number", "integer"):
        bounds = [
            [schema[key] for key in keys if key in schema]
            for keys in (("minimum", "exclusiveMinimum"), ("maximum", "exclusiveMaximum"))
        ]
        if not all(bound and abs(bound[0]) <= 1e6 for bound in bounds):
            yield at
    for key, one in schema.items():
        yield from unbounded(one, f"{at}.{key}")


def test_every_kind_of_calibration_has_a_model_in_these_tests():
    assert MODELS.keys() == KINDS.keys()


@pytest.mark.parametrize("file", list(MODELS))
def test_every_number_of_a_calibration_file_has_a_lower_and_an_upper_bound(file: str):
    assert list(unbounded(TypeAdapter(MODELS[file]).json_schema(), file)) == []


def test_complete_calibration_is_read_without_a_warning(folder: Path):
    found = BenchCalibration.load(folder, DESCRIBED, FITTED)
    assert found.warnings == ()
    assert found.views["left"].lens.focal == (642.1, 641.5)


def spoilt(at: str, new: float) -> Callable[[Document], Document]:
    key = tuple(int(part) if part.isdigit() else part for part in at.split("."))
    return lambda table: with_number(table, key, new)


def skew(matrix: np.ndarray) -> Callable[[Document], Document]:
    def change(table: Document) -> Document:
        inner = table["tubes"]["inner"] | {"skew": matrix.tolist()}
        return table | {"tubes": table["tubes"] | {"inner": inner}}

    return change


ABSURD = {
    "tracker 1e308 m away": (REGISTRATION_FILE, "position.0", 1e308),
    "tracker turned by 1e308 rad": (REGISTRATION_FILE, "rotation_vector.1", 1e308),
    "coil 0.5 m off the tip": (REGISTRATION_FILE, "coil.2", 0.5),
    "rms error of 1 km": (REGISTRATION_FILE, "rms_error", 1000.0),
    "negative interval": (REGISTRATION_FILE, "position_interval.0", -1.0),
    "interval of a million turns": (REGISTRATION_FILE, "rotation_interval.2", 6e6),
    "weight of 1e300 N": (SENSORS_FILE, "tubes.inner.weight", 1e300),
    "first moment of 1e6 N m": (SENSORS_FILE, "tubes.inner.first_moment.0", 1e6),
    "sensor upside down": (SENSORS_FILE, "tubes.inner.mounting.0", math.pi),
    "gravity of length 0": (SENSORS_FILE, "gravity.0", 0.0),
    "gravity of length 9.81": (SENSORS_FILE, "gravity.0", 9.81),
    "gravity upward": (SENSORS_FILE, "gravity.0", -1.0),
    "skew of a million": (SENSORS_FILE, "tubes.inner.skew.0.0", 1e6),
    "EI x 1000": (ROBOT_FILE, "tubes.0.bending_stiffness", 14.7),
    "straight part of 4 m": (ROBOT_FILE, "tubes.0.sections.0.length", 4.0),
    "camera 1e308 m away": (CAMERAS_FILE, "cameras.left.pose.position.1", 1e308),
}


def refusal(folder: Path, file: str, change: Callable[[Document], Document], to: Path) -> str:
    """Return the reason why a calibration with a changed file is refused; empty if it is accepted."""
    shutil.copytree(folder, to, dirs_exist_ok=True)
    table = change(tomllib.loads((folder / file).read_text(encoding="utf-8")))
    (to / file).write_text("\n".join(toml_lines(table)) + "\n", encoding="utf-8")
    try:
        BenchCalibration.load(to, DESCRIBED, FITTED)
    except ConfigError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("file", "at", "new"), list(ABSURD.values()), ids=list(ABSURD))
def test_absurd_calibration_is_refused_with_file_key_and_value(folder: Path, tmp_path: Path, file, at, new):
    reason = refusal(folder, file, spoilt(at, new), tmp_path / "spoilt")
    assert file in reason
    assert [part for part in at.split(".") if not part.isdigit()][-1] in reason
    assert f"{new:g}" in reason or repr(new) in reason


@pytest.mark.parametrize("diagonal", [2.0, 1.0, -2.0, 0.5])
def test_gain_that_turns_or_hides_a_force_is_refused(folder: Path, tmp_path: Path, diagonal: float):
    reason = refusal(folder, SENSORS_FILE, skew(diagonal * np.eye(6)), tmp_path / "spoilt")
    assert f"tubes.inner.skew.0.0 = {diagonal}" in reason


def test_curvature_of_the_opposite_sign_is_refused(folder: Path, tmp_path: Path):
    change = spoilt("tubes.0.sections.1.curvature.0", -6.0)
    reason = refusal(folder, ROBOT_FILE, change, tmp_path / "spoilt")
    assert "tubes.inner.sections.2.curvature, direction from the described one = -3.14" in reason


def test_gains_that_hide_a_force_together_are_refused(folder: Path, tmp_path: Path):
    """Each number is within its range, but together they hide almost half of a force along (1, 1, 1)."""
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = 0.1
    matrix[:3, 3:], matrix[3:, :3], matrix[3:, 3:] = 7.2, 0.1 / 72.0, 0.1
    reason = refusal(folder, SENSORS_FILE, skew(matrix), tmp_path / "spoilt")
    assert "leaves 0.4 of a wrench in its weakest direction" in reason


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("device", "/dev/v4l/by-id/right", f"device = '{DEVICE}', but the camera has '/dev/v4l/by-id/right'"),
        ("width", 1280, "width = 640, but the camera has 1280"),
        ("height", 720, "height = 480, but the camera has 720"),
    ],
)
def test_calibration_of_another_camera_is_refused(folder: Path, key: str, value: Any, reason: str):
    other = {"left": FITTED["left"].model_copy(update={key: value})}
    with pytest.raises(ConfigError, match=f"cameras.left was calibrated with {reason}"):
        BenchCalibration.load(folder, DESCRIBED, other)


def test_calibration_of_a_camera_that_is_not_fitted_causes_a_warning(folder: Path):
    (text,) = BenchCalibration.load(folder, DESCRIBED, {}).warnings
    assert "camera 'left' is calibrated, but the station has no camera of this name" in text


@pytest.mark.parametrize("missing", ["robot", "board", "device"])
def test_calibration_of_cameras_names_robot_board_and_camera(folder: Path, tmp_path: Path, missing: str):
    def without(table: Document) -> Document:
        return {
            key: without(value) if isinstance(value, dict) else value for key, value in table.items() if key != missing
        }

    reason = refusal(folder, CAMERAS_FILE, without, tmp_path / "spoilt")
    assert reason.endswith(f"{missing}' is missing (line 4)") or f"{missing}' is missing" in reason


def test_calibration_of_the_cameras_of_another_robot_is_refused(folder: Path, tmp_path: Path):
    reason = refusal(folder, CAMERAS_FILE, lambda table: table | {"robot": "theirs"}, tmp_path / "spoilt")
    assert "made for robot 'theirs', but the robot is 'mine'" in reason


MUTATIONS: list[Callable[[float], float]] = [
    lambda _: 1e308, lambda _: -1e308, lambda _: math.nan, lambda _: math.inf, lambda _: 0.0, lambda _: -1.0,
    lambda _: 1.0, lambda value: -value, lambda value: 1000.0 * value, lambda value: 1e-3 * value,
    lambda value: 2.2 * value, lambda value: value + 0.05, lambda value: 1.02 * value,
]  # fmt: skip


@settings(
    max_examples=EXAMPLES,
    derandomize=True,
    database=None,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_changed_number_of_a_calibration_is_refused_with_its_key_or_harmless(folder: Path, tmp_path: Path, data):
    to = tmp_path / "changed"
    shutil.copytree(folder, to, dirs_exist_ok=True)
    touched: list[tuple[str, str]] = []
    for _ in range(data.draw(st.integers(1, 3))):
        file = data.draw(st.sampled_from(list(MODELS)))
        table = tomllib.loads((to / file).read_text(encoding="utf-8"))
        at, value = data.draw(st.sampled_from(list(numbers(table))))
        new = data.draw(st.sampled_from(MUTATIONS))(value)
        if isinstance(value, int):
            new = int(new) if math.isfinite(new) and abs(new) < 1e6 else 10**9
        (to / file).write_text("\n".join(toml_lines(with_number(table, at, new))) + "\n", encoding="utf-8")
        touched.append((file, next(str(part) for part in reversed(at) if not isinstance(part, int))))
    reason = ""
    try:
        check_harmless(BenchCalibration.load(to, DESCRIBED, FITTED))
    except CtrError as error:
        reason = str(error)
    if reason:
        assert "\n" not in reason
        assert any(file in reason for file, _ in touched)
        # A message of the model about a tube or joint names it instead of the key.
        assert any(key in reason for _, key in touched) or re.search(r"tube '|joint|inner|outer", reason)


def check_harmless(found: BenchCalibration) -> None:
    """Check the effects of an accepted calibration on tracker, sensors, model and limits."""
    assert found.registration is not None
    rotation, position = found.registration.rotation, found.registration.position
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-9)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert np.linalg.norm(position) < 20.0
    assert np.linalg.norm(found.corrections.coil) < 0.2
    assert abs(found.latency) <= 0.5
    sensors = found.corrections.sensors
    weightless = Sensors(sensors.mounting, np.zeros(2), np.zeros((2, 3)), sensors.gravity, sensors.skew)
    for direction in np.vstack([np.eye(3), -np.eye(3), np.ones((1, 3)) / math.sqrt(3.0)]):
        wrenches = np.hstack([np.tile(direction, (2, 1)), np.zeros((2, 3))])
        for measured in weightless.exerted(found.robot.robot(), np.zeros(3), wrenches)[:, :3]:
            assert measured @ direction > 0.3
            assert np.linalg.norm(measured) < 2.0
    assert np.abs(sensors.exerted(found.robot.robot(), np.zeros(3), np.zeros((2, 6)))[:, :3]).max() <= 5.01
    described, robot = DESCRIBED, found.robot
    assert robot.joints == described.joints
    assert (robot.workspace, robot.max_force, robot.base) == (None, None, described.base)
    np.testing.assert_array_equal(robot.limits().packed, described.limits().packed)
    pose = np.array([0.0, 1.5708, -0.05])
    there, expected = (Statics(file.robot()).solve(pose, np.zeros(6)).tip for file in (robot, described))
    assert np.linalg.norm(np.asarray(there) - expected) < 0.15


ONE_SENSOR = """
robot = "paper"
made = "here"
gravity = [1.0, 0.0, 0.0]
[robot_sensor]
mounting = [0.0, 0.0, 0.1]
weights.inner = { weight = 0.2, first_moment = [1e-3, 0.0, 0.0] }
weights.outer = { weight = 0.1, first_moment = [0.0, 2e-3, 0.0] }
"""


def test_the_calibration_of_a_sensor_under_the_robot_applies_to_a_bench_that_has_one(tmp_path, paper):
    (tmp_path / SENSORS_FILE).write_text(ONE_SENSOR, encoding="utf-8")
    one = paper.sensed_at("robot", "at")
    found = BenchCalibration.load(tmp_path, one)

    sensors = found.corrections.sensors
    np.testing.assert_allclose(sensors.mounting, [rotation_from_vector(np.array([0.0, 0.0, 0.1]))], atol=1e-12)
    np.testing.assert_array_equal(sensors.weight, [0.2, 0.1])
    np.testing.assert_array_equal(sensors.first_moment, [[1e-3, 0.0, 0.0], [0.0, 2e-3, 0.0]])
    with pytest.raises(ConfigError, match="force sensors at 'robot', but the bench has them at 'tubes'"):
        BenchCalibration.load(tmp_path, paper)
    (tmp_path / SENSORS_FILE).write_text(ONE_SENSOR.replace("weights.outer", "#"), encoding="utf-8")
    with pytest.raises(ConfigError, match="outer is missing"):
        BenchCalibration.load(tmp_path, one)
    blind = Present(sensors=False)
    controller = found.applied(default_controller(blind).controller(one, blind))
    assert controller.corrections is not None
    assert not controller.corrections.sensors.weight.any()  # without readings a weight would look like a load
