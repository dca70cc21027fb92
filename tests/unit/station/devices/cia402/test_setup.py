"""Options of CANopen drives, and the conversion of their counts and velocities."""

import pytest

from station.config.strict import ConfigError
from station.devices.cia402.setup import DriveFile, DriveSetup
from station.devices.cia402.stages import CIA402


def joints(**changes: object) -> dict[str, object]:
    """Return the options of three drives with `changes` of the last one."""
    return {"outer_rotation": {"node": 1}, "inner_rotation": {"node": 2}, "inner_translation": {"node": 3} | changes}


def test_setups_of_the_papers_stages_have_the_expected_numbers(paper):
    turning, _, slide = (DriveSetup.of(joint, DriveFile(node=1)) for joint in paper.joints)
    assert (turning.minimum, turning.maximum, turning.turn) == (-1_536_000, 1_536_000, 1_536_000)
    assert turning.top == 85_333  # 20 deg/s / 0.000234375 deg
    assert (slide.minimum, slide.maximum) == (0, 251_968)  # 125 mm
    assert slide.acceleration == 201_575  # 100 mm/s^2 / 0.49609375 um, rounded up
    assert (turning.homing_method, slide.homing_method) == (21, 17)


def test_makes_have_their_own_units_of_velocity(paper):
    # 20 mm/s / 0.49609375 um = 40315 counts/s; with 4096 counts per turn 9.8425 turns/s = 590.55 turns/min.
    epos, faulhaber = (
        DriveSetup.of(paper.joints[2], DriveFile(node=1, make=make, counts_per_turn=4096.0))
        for make in ("epos4", "faulhaber")
    )
    assert (epos.top, faulhaber.top) == (590_551, 591)
    # 100 mm/s^2 are 201 575 counts/s^2 or 49.21 turns/s^2; Faulhaber's unit, EPOS4 has turns per minute and second.
    assert (epos.acceleration, faulhaber.acceleration) == (2953, 50)


def test_backward_drive_counts_from_the_other_end(paper):
    slide = DriveSetup.of(paper.joints[2], DriveFile(node=1, backwards=True))
    assert slide.position(0) == -0.005
    assert slide.position(slide.maximum) == pytest.approx(-0.130, abs=1e-6)
    assert slide.velocity_step < 0.0


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({}, "devices.stages: 'port' is missing"),
        ({"port": "COM3", "joints": {"outer_rotation": {"node": 1}}}, "joints.inner_rotation is missing"),
        ({"port": "COM3", "joints": joints(node=2)}, "inner_translation.node = 2: inner_rotation has the same axis"),
        ({"port": "COM3", "joints": joints(node=127)}, "node"),
        ({"port": "COM3", "joints": joints(home_at=-0.1)}, "inner_translation: home_at -0.1 m is inside the travel"),
        ({"port": "COM3", "joints": joints(make="epos4")}, "inner_translation: counts_per_turn is missing"),
    ],
)
def test_invalid_options_are_refused_by_name(paper, options, part):
    with pytest.raises(ConfigError, match=part):
        CIA402.open(options, paper)
