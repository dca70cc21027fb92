"""A calibration changes what it has measured; everything else comes from the robot's file, and changes are reported."""

import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from core.errors import CtrError
from station.calibration.files import write_described
from station.config.robots import RobotFile, load_robot
from station.config.strict import ConfigError
from station.control.bench_calibration import BenchCalibration
from station.control.calibrated_robot import DESCRIBED_FILE, KINDS, REGISTRATION_FILE, ROBOT_FILE, SENSORS_FILE
from station.service.station_file import load_station
from tests.harness.root import ROOT

KEPT = ROOT / "tests" / "harness" / "calibrated_bench"
#: Last parts of the keys that the procedure `tubes` measures, as in the instructions of the procedure.
MEASURED = ("bending_stiffness", "poisson_ratio", "torsional_stiffness", "length", "curvature")
#: Keys whose changes do not matter to a calibration.
SILENT = (
    "source", "working_pose", "workspace", "max_force", "integrator", "ends_in_order", "lower", "upper", "speed",
    "acceleration",
)  # fmt: skip

Path_ = tuple[str | int, ...]


def full() -> RobotFile:
    """Return a robot's file with a value for every key, so that each key can be changed."""
    robot = load_robot(str(KEPT / "robot.toml"))
    tubes = [
        tube.model_dump()
        | {
            "torsional_stiffness": 0.8 * tube.bending_stiffness,
            "sections": tuple(
                {"length": section.length, "curvature": (section.curvature[0] + 0.1, 0.1)} for section in tube.sections
            ),
        }
        for tube in robot.tubes
    ]
    box = {"lower": (-0.2, -0.2, 0.0), "upper": (0.2, 0.2, 0.4)}
    values = robot.model_dump() | {"tubes": tuple(tubes), "workspace": box, "max_force": 0.3, "integrator": "paper"}
    return RobotFile.model_validate(values)


def leaves(value: Any, at: Path_ = ()) -> Iterator[tuple[Path_, Any]]:
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from leaves(one, (*at, key))
    elif isinstance(value, tuple):
        for number, one in enumerate(value):
            yield from leaves(one, (*at, number))
    else:
        yield at, value


def replaced(value: Any, at: Path_, new: Any) -> Any:
    if not at:
        return new
    if isinstance(value, Mapping):
        return {key: replaced(one, at[1:], new) if key == at[0] else one for key, one in value.items()}
    return tuple(replaced(one, at[1:], new) if number == at[0] else one for number, one in enumerate(value))


def other(at: Path_, value: Any) -> Any:
    """Return another valid value of a key."""
    if isinstance(value, bool):
        return not value
    if at[-1] == "motion":
        return "translation" if value == "rotation" else "rotation"
    if at[-1] == "integrator":
        return None
    if at[-1] == "tube":
        return "inner" if value == "outer" else "outer"
    if isinstance(value, str):
        return f"{value}_2"
    if at[-1] == "translation":
        return value - 1e-4
    return 1e-4 if value == 0.0 else 0.999 * value


def changed(file: RobotFile, at: Path_) -> RobotFile:
    values = file.model_dump()
    return RobotFile.model_validate(replaced(values, at, other(at, dict(leaves(values))[at])))


KEYS = [at for at, _ in leaves(full().model_dump()) if at[0] != "format"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "calibration"
    path.mkdir()
    return path


def write_robot_file(folder: Path, file: RobotFile) -> None:
    write_described(folder, file).rename(folder / ROBOT_FILE)


def test_every_key_of_a_robot_file_is_set_in_these_tests():
    assert [at for at, value in leaves(full().model_dump()) if value is None] == []


def loaded(folder: Path, robot: RobotFile) -> BenchCalibration | str:
    """Return the calibration, or the reason why it is refused."""
    try:
        return BenchCalibration.load(folder, robot)
    except CtrError as error:
        return str(error)


@pytest.mark.parametrize("at", KEYS, ids=lambda at: ".".join(map(str, at)))
def test_key_of_a_calibrated_robot_file_is_not_used_unless_it_was_measured(at: Path_, folder: Path):
    """The keys come from the model of the file, so that keys of later versions are tested, too."""
    described = full()
    before = dict(leaves(described.model_dump()))[at]
    write_robot_file(folder, changed(described, at))
    write_described(folder, described)

    found = loaded(folder, described)

    if any(part in MEASURED for part in at):
        assert isinstance(found, BenchCalibration)
        values = found.robot.model_dump()
        assert dict(leaves(values))[at] == other(at, before)
        assert replaced(values, at, before) == described.model_dump()
        assert found.warnings == ()
    elif any(part in SILENT for part in at):
        assert isinstance(found, BenchCalibration)
        assert found.robot == described
        assert found.warnings == ()
    elif isinstance(found, BenchCalibration):
        assert found.robot == described
        assert any(str(at[-1]) in text or str(at[-2]) in text for text in found.warnings)
    else:
        assert repr(other(at, before)) in found or f"'{other(at, before)}'" in found or "joint" in found


@pytest.mark.parametrize("at", KEYS, ids=lambda at: ".".join(map(str, at)))
def test_later_change_of_the_robot_file_applies_or_is_reported(at: Path_, folder: Path):
    described = full()
    before = dict(leaves(described.model_dump()))[at]
    write_robot_file(folder, described)
    write_described(folder, described)
    now = changed(described, at)

    found = loaded(folder, now)

    if any(part in SILENT for part in at):
        assert isinstance(found, BenchCalibration)
        assert (found.robot, found.warnings) == (now, ())
    elif isinstance(found, BenchCalibration):
        assert at[0] != "tubes"
        assert found.robot == now
        (text,) = found.warnings
        assert str(at[-1]) in text or str(at[-2]) in text
    else:
        new = other(at, before)
        assert at[-1] == "name" or str(new) in found or str(at[-2]) in found or "joint" in found


def test_limits_that_were_set_after_the_calibration_apply(write: Callable[..., Path], tmp_path: Path):
    """Force, workspace and speed limits of the robot's file apply, although the calibrated file has none of them."""
    text = (KEPT / "robot.toml").read_text(encoding="utf-8")
    limited = text.replace("[[tubes]]", 'max_force = 0.3\nworkspace = { lower = [-0.03, -0.1, 0.0], upper = [0.1, 0.1, '
                           "0.3] }\n\n[[tubes]]", 1).replace("speed = 0.020", "speed = 0.010")  # fmt: skip
    robot = load_robot(str(write(limited, "robot")))
    station = write(f'robot = "robot.toml"\ncalibration = "{KEPT / "calibration"}"\n', "station")

    bench = load_station(station).bench()

    assert bench.max_force == 0.3
    np.testing.assert_array_equal(bench.limits.packed, robot.limits().packed)
    assert [limit.names for limit in bench.limits.others] == [limit.names for limit in robot.limits().others]
    assert bench.best_known_robot.tubes[0].bending_stiffness == 0.015522291


@pytest.mark.parametrize("file", [REGISTRATION_FILE, ROBOT_FILE])
def test_calibration_of_a_tube_that_was_changed_since_is_refused_with_both_values(file: str, folder: Path):
    described = load_robot(str(KEPT / "robot.toml"))
    shutil.copy(KEPT / "calibration" / file, folder)
    write_described(folder, described)
    assert BenchCalibration.load(folder, described).warnings == ()
    inner = described.tubes[0].model_copy(update={"bending_stiffness": 0.0201})
    now = described.model_copy(update={"tubes": (inner, described.tubes[1])})

    with pytest.raises(
        ConfigError, match=rf"{file}: made for tubes.inner.bending_stiffness = 0.0147, .* now has 0.0201: calibrate"
    ):
        BenchCalibration.load(folder, now)


def test_calibration_without_the_former_robot_file_causes_a_warning():
    (text,) = BenchCalibration.load(KEPT / "calibration", load_robot(str(KEPT / "robot.toml"))).warnings
    assert f"has no {DESCRIBED_FILE}" in text


def test_calibration_without_the_former_robot_file_is_refused_if_its_copied_keys_differ():
    described = load_robot(str(KEPT / "robot.toml"))
    outer = described.tubes[1].model_copy(update={"outer_diameter": 0.0023})
    now = described.model_copy(update={"tubes": (described.tubes[0], outer)})
    with pytest.raises(ConfigError, match=r"tubes\.outer\.outer_diameter = 0\.0022, .* now has 0\.0023"):
        BenchCalibration.load(KEPT / "calibration", now)


def test_calibration_of_the_sensors_alone_is_used_with_other_tubes(folder: Path):
    described = load_robot(str(KEPT / "robot.toml"))
    shutil.copy(KEPT / "calibration" / SENSORS_FILE, folder)
    write_described(folder, described)
    inner = described.tubes[0].model_copy(update={"bending_stiffness": 0.0201})
    now = described.model_copy(update={"tubes": (inner, described.tubes[1])})

    found = BenchCalibration.load(folder, now)

    assert found.robot == now
    (text,) = found.warnings
    assert "tubes.inner.bending_stiffness = 0.0147, but the robot's file now has 0.0201" in text


def test_table_of_what_a_calibration_changes_has_only_measured_keys_of_tubes():
    replaced_keys = {key for kind in KINDS.values() for key in kind.replaces}
    assert {key.rsplit(".", 1)[1] for key in replaced_keys} == set(MEASURED)
    assert all(key.startswith("tubes.") for key in replaced_keys)
