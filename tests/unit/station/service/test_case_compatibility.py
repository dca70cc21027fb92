"""A case for another robot is refused; a case for another lab or calibration gets a warning."""

from pathlib import Path

import pytest

from station.config.robots import load_robot
from station.experiments.experiment import load_experiment
from station.service.case_compatibility import deviations_from_case, incompatibility
from station.service.station_file import load_station
from station.service.station_service import StationService
from station.service.supervisor import Supervisor
from tests.harness.cases import a_case
from tests.harness.own_devices import OWN_DEVICES


@pytest.fixture(scope="module")
def bench():
    return load_station(None).bench()


def test_case_for_another_robot_is_refused_with_both_names():
    three = load_station(None, {"robot": "three_tubes"}).bench()
    assert "for robot 'paper'; this station has 'three_tubes'" in incompatibility(a_case("fig8", "regulation"), three)


def test_case_is_refused_if_a_robot_of_the_same_name_differs(bench):
    other = load_robot("paper").model_copy(update={"max_force": 1.0})
    case = a_case("fig8", "regulation")._replace(robot=other)
    assert "this station's robot of that name differs" in incompatibility(case, bench)


def test_warning_names_both_labs_if_the_lab_differs(bench):
    (text,) = deviations_from_case(a_case("fig8", "regulation_distorted"), bench)
    assert text.startswith("written for lab 'distorted', runs on this station instead: virtual lab: ")
    assert "serve --lab distorted" in text
    assert incompatibility(a_case("fig8", "regulation_distorted"), bench) == ""


def test_case_without_a_lab_is_compatible_with_every_lab(bench):
    realistic = load_station(None, {"lab": "realistic"}).bench()
    for one in (bench, realistic):
        assert deviations_from_case(a_case("fig8", "regulation"), one) == ()


def test_case_for_the_lab_of_the_station_is_compatible(bench):
    distorted = load_station(None, {"lab": "distorted"}).bench()
    assert deviations_from_case(a_case("fig8", "regulation_distorted"), distorted) == ()


def test_warning_names_the_bench_if_the_devices_are_real(write):
    own = load_station(write(OWN_DEVICES)).bench()
    (text,) = deviations_from_case(a_case("fig3", "a"), own)
    assert "written for lab 'ideal', runs on this station instead: bench of 'paper'" in text


def test_case_that_follows_a_target_requires_a_target_coil(bench, write):
    follows = a_case("follow", "breathing")
    assert "no second coil for one: `serve --lab breathing`" in incompatibility(follows, bench)
    assert "name its coil in devices.tracker.target" in incompatibility(
        follows, load_station(write(OWN_DEVICES)).bench()
    )
    assert incompatibility(follows, load_station(None, {"lab": "heartbeat"}).bench()) == ""


def test_case_with_faults_requires_the_virtual_lab(write, short):
    text = short + '[[faults]]\nkind = "mute"\ndevice = "tracker"\nat = 0.5\n'
    (case,) = load_experiment(str(write(text, "muted"))).cases
    assert "its faults are for the virtual lab's devices" in incompatibility(
        case, load_station(write(OWN_DEVICES)).bench()
    )


def test_warning_names_both_calibrations_if_the_calibration_differs(bench):
    case = a_case("fig8", "regulation", calibration="found/monday")
    (text,) = deviations_from_case(case, bench)
    begin = f"written with the calibration {Path('found/monday')}, runs with this station's (none)"
    assert text.startswith(begin)


def test_recording_has_the_present_lab_and_the_deviations_from_the_case(bench):
    supervisor = Supervisor(bench)
    try:
        start = StationService(supervisor).of_experiment("fig8", "regulation_distorted")
        plain = StationService(supervisor).of_experiment("fig8", "regulation")
    finally:
        supervisor.close()
    (text,) = start.about["otherwise"]
    assert start.warnings[0] == text
    assert start.about["settings"]["lab"] == "gentle"
    assert plain.about["otherwise"] == []
