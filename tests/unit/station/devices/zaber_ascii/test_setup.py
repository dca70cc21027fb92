"""Options of Zaber ASCII stages, and the conversion of their positions."""

import math

import pytest

from station.config.strict import ConfigError
from station.devices.zaber_ascii.setup import AsciiSetup, AsciiStageFile
from station.devices.zaber_ascii.stages import ZABER_ASCII


def test_setups_of_the_papers_stages_have_the_expected_numbers(paper):
    turning, _, slide = (AsciiSetup.of(joint, AsciiStageFile(device=1)) for joint in paper.joints)
    assert (turning.minimum, turning.maximum, turning.turn) == (-1_536_000, 1_536_000, 1_536_000)
    assert turning.top == 139_810  # 20 deg/s * 1.6384 / 0.000234375 deg
    assert (slide.minimum, slide.maximum) == (0, 251_968)  # 125 mm
    assert slide.acceleration == 34  # 100 mm/s^2 * 1.6384e-4 / 0.49609375 um = 33.03, rounded up
    assert slide.position(0) == -0.130


def test_backward_stage_counts_from_the_other_end(paper):
    slide = AsciiSetup.of(paper.joints[2], AsciiStageFile(device=1, backwards=True))
    assert slide.position(0) == -0.005
    assert slide.position(slide.maximum) == pytest.approx(-0.130, abs=1e-6)
    turning = AsciiSetup.of(paper.joints[0], AsciiStageFile(device=1, backwards=True, home_at=math.pi))
    assert turning.position(turning.minimum) == pytest.approx(paper.joints[0].upper, abs=1e-5)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({}, "devices.stages: 'port' is missing"),
        ({"port": "COM3", "baud": 9600}, "baud"),
        ({"port": "COM3", "joints": {"outer_rotation": {"device": 1}}}, "joints.inner_rotation is missing"),
        (
            {
                "port": "COM3",
                "joints": {
                    "outer_rotation": {"device": 1},
                    "inner_rotation": {"device": 1},
                    "inner_translation": {"device": 2},
                },
            },
            "inner_rotation.device = 1: outer_rotation has the same axis",
        ),
        (
            {
                "port": "COM3",
                "joints": {
                    "outer_rotation": {"device": 1},
                    "inner_rotation": {"device": 1, "axis": 2},
                    "inner_translation": {"device": 2, "home_at": -0.1},
                },
            },
            "inner_translation: home_at -0.1 m is inside the travel",
        ),
    ],
)
def test_invalid_options_are_refused_by_name(paper, options, part):
    with pytest.raises(ConfigError, match=part):
        ZABER_ASCII.open(options, paper)
