"""A calibration is applied to the station's file, or to the session without a file, and the choice can be undone."""

from pathlib import Path

import pytest

from station.calibration.files import write_latency
from station.config.strict import ConfigError
from station.control.states import RefusedError
from station.service.calibration_choice import CalibrationChoice
from station.service.station_file import load_station
from tests.harness.own_devices import OWN_DEVICES

FILE = '# The bench of room 4.\nrobot = "paper"  # the small one\n\n[margins]\nuncertainty = 0.05\n'


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """Return the folder of a calibration: the tracker is 6.6 ms later than configured."""
    folder = tmp_path / "calibrations" / "latency-1"
    write_latency(folder, 0.0066, "today")
    return folder


def test_applied_calibration_is_a_line_of_the_station_file_and_every_other_line_stays(tmp_path, result):
    path = tmp_path / "bench.toml"
    path.write_text(FILE)
    choice = CalibrationChoice(path)

    choice.apply(result)

    assert path.read_text().splitlines() == [FILE.splitlines()[0], f'calibration = "{result}"', *FILE.splitlines()[1:]]
    assert load_station(path).bench().calibration.latency == 0.0066
    assert choice.restart.is_set()
    choice.undo()
    assert path.read_text() == FILE
    assert not choice.can_undo


def test_applied_calibration_replaces_the_previous_line(tmp_path, result):
    earlier = tmp_path / "earlier"
    write_latency(earlier, 0.001, "yesterday")
    path = tmp_path / "bench.toml"
    path.write_text(f'robot = "paper"\ncalibration = "{earlier}"\nseed = 3\n')

    CalibrationChoice(path).apply(result)

    assert path.read_text() == f'robot = "paper"\ncalibration = "{result}"\nseed = 3\n'


@pytest.mark.parametrize("changes", [{}, {"calibration": "elsewhere"}])
def test_without_a_station_file_the_choice_is_valid_until_the_program_ends(tmp_path, result, changes):
    path = tmp_path / "bench.toml"
    path.write_text(FILE)
    choice = CalibrationChoice(path if changes else None, changes)

    choice.apply(result)

    assert choice.file is None
    assert choice.changes == {"calibration": str(result)}
    assert path.read_text() == FILE
    choice.undo()
    assert choice.changes == changes


def test_calibration_that_the_station_cannot_use_changes_nothing(tmp_path):
    path, empty = tmp_path / "bench.toml", tmp_path / "empty"
    path.write_text(FILE)
    empty.mkdir()
    choice = CalibrationChoice(path)

    with pytest.raises(ConfigError, match=r"none of registration\.toml"):
        choice.apply(empty)

    assert path.read_text() == FILE
    assert not choice.restart.is_set()


def test_undo_refuses_to_overwrite_a_station_file_that_has_changed_since(tmp_path, result):
    path = tmp_path / "bench.toml"
    path.write_text(FILE)
    choice = CalibrationChoice(path)
    with pytest.raises(RefusedError, match="nothing to undo"):
        choice.undo()
    choice.apply(result)
    path.write_text(path.read_text() + "# a note\n")

    with pytest.raises(RefusedError, match="has changed since"):
        choice.undo()

    assert path.read_text().endswith("# a note\n")


@pytest.mark.parametrize(("line", "expected"), [("", 0.0306), ("latency = 0.030\n", 0.0366)])
def test_calibrated_latency_is_added_to_the_configured_one(write, result, line, expected):
    """The default of an NDI Aurora is 24 ms (station/docs/pages/explanations/defaults.md)."""
    port = 'port = "/dev/ttyUSB1"\n'
    path = write(f'calibration = "{result}"\n' + OWN_DEVICES.replace(port, port + line))
    bench = load_station(path).bench()

    assert bench.registered(bench.devices).tracker["latency"] == pytest.approx(expected, abs=1e-12)
