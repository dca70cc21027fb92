"""A case for another robot is refused; for another lab or calibration it is told."""

from pathlib import Path

import pytest

from station.config.robots import load_robot
from station.experiments.experiment import load_experiment
from station.service.fits import otherwise, refusal
from station.service.station_file import load_station
from station.service.station_service import StationService
from station.service.supervisor import Supervisor
from tests.harness.cases import a_case
from tests.harness.own_devices import OWN_DEVICES


@pytest.fixture(scope="module")
def bench():
    return load_station(None).bench()


def test_a_case_of_another_robot_is_refused_with_both_names():
    three = load_station(None, {"robot": "three_tubes"}).bench()
    assert "for robot 'paper'; this station has 'three_tubes'" in refusal(a_case("fig8", "regulation"), three)


def test_a_robot_of_the_same_name_that_differs_is_another(bench):
    other = load_robot("paper").model_copy(update={"max_force": 1.0})
    case = a_case("fig8", "regulation")._replace(robot=other)
    assert "this station's robot of that name differs" in refusal(case, bench)


def test_a_case_of_another_lab_is_told_with_both(bench):
    (text,) = otherwise(a_case("fig8", "regulation_distorted"), bench)
    assert text.startswith("written for lab 'distorted', carried out on this station's own: virtual lab: ")
    assert "serve --lab distorted" in text
    assert refusal(a_case("fig8", "regulation_distorted"), bench) == ""


def test_a_case_that_names_no_lab_fits_every_lab(bench):
    realistic = load_station(None, {"lab": "realistic"}).bench()
    for one in (bench, realistic):
        assert otherwise(a_case("fig8", "regulation"), one) == ()


def test_a_case_of_this_stations_lab_fits(bench):
    distorted = load_station(None, {"lab": "distorted"}).bench()
    assert otherwise(a_case("fig8", "regulation_distorted"), distorted) == ()


def test_a_bench_of_ones_own_is_no_lab(write):
    own = load_station(write(OWN_DEVICES)).bench()
    (text,) = otherwise(a_case("fig3", "a"), own)
    assert "written for lab 'ideal', carried out on this station's own: bench of 'paper'" in text


def test_a_case_that_follows_needs_a_target(bench, write):
    follows = a_case("follow", "breathing")
    assert "no second coil for one: `serve --lab breathing`" in refusal(follows, bench)
    assert "name its coil in devices.tracker.target" in refusal(follows, load_station(write(OWN_DEVICES)).bench())
    assert refusal(follows, load_station(None, {"lab": "heartbeat"}).bench()) == ""


def test_faults_need_the_virtual_lab(write, short):
    text = short + '[[faults]]\nkind = "mute"\ndevice = "tracker"\nat = 0.5\n'
    (case,) = load_experiment(str(write(text, "muted"))).cases
    assert "its faults are of the virtual lab's devices" in refusal(case, load_station(write(OWN_DEVICES)).bench())


def test_another_calibration_is_told(bench):
    case = a_case("fig8", "regulation", calibration="found/monday")
    (text,) = otherwise(case, bench)
    begin = f"written with the calibration {Path('found/monday')}, carried out with this station's (none)"
    assert text.startswith(begin)


def test_the_recording_has_the_lab_that_was_there_and_says_what_was_otherwise(bench):
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
