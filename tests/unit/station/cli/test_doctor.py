"""Findings of `doctor` about the stages of a station file."""

from itertools import islice, takewhile

import pytest

from station.cli.doctor import findings
from station.devices.cia402.sequences import OBJECTS
from station.devices.gcode.sequences import GRBL_AXIS_SETTINGS, GRBL_SETTINGS, MARLIN_SETTINGS
from station.devices.zaber.sequences import SETTINGS as ZABER
from station.devices.zaber_ascii.sequences import SETTINGS as ASCII
from station.lab.simulated_stages import STAGES

TABLES = {
    "zaber": ZABER.values(),
    "zaber_ascii": ASCII.values(),
    "cia402": [setting for (index, _), (setting, _) in OBJECTS.items() if index not in (0x60AA, 0x6080)],
    "grbl": (*GRBL_SETTINGS.values(), *GRBL_AXIS_SETTINGS.values()),
    "marlin": MARLIN_SETTINGS.values(),
}


def test_doctor_prints_the_latency_of_the_stages_and_what_the_controller_plans_for(write):
    texts = [
        next(findings(write('lab = { stages = "cia402" }\n' + keys))).text
        for keys in ("", "[controller]\ncommand_interval = 0.025\n")
    ]
    assert texts[0] == "each stage gets a velocity every 4 ms, 0.63 ms after it was sent"
    assert texts[1].startswith(texts[0] + "; the controller plans for 25 ms and 0.63 ms (keys command_interval")


def test_doctor_prints_the_settings_of_the_stages_as_read_and_as_set(write):
    found = [
        each.text
        for each in takewhile(
            lambda each: each.subject in ("stages", "setting"), findings(write('lab = { stages = "grbl" }\n'))
        )
    ]
    everywhere = "(outer_rotation, inner_rotation, inner_translation)"
    assert f"$1 = 25: the motors lose their current 25 ms after a motion (255: never); set to 255 {everywhere}" in found
    assert f"$13 = 0: unit of reports (1: inches) {everywhere}" in found
    assert "$112 = 500: largest speed [unit/min]; set to 1200 (inner_translation)" in found


@pytest.mark.parametrize("kind", STAGES)
def test_doctor_prints_every_setting_of_a_drivers_table(write, kind):
    printed = " ".join(each.text for each in takewhile(
        lambda each: each.subject in ("stages", "setting"), findings(write(f'lab = {{ stages = "{kind}" }}\n'))
    ))  # fmt: skip
    for setting in TABLES[kind]:
        assert f"{setting.name} = " in printed


def test_doctor_reports_stages_that_cannot_be_opened(write, tmp_path):
    stages = f'[devices.stages]\ndriver = "zaber_ascii"\nport = "{tmp_path}/none"\n'
    found = [each for each in islice(findings(write(stages)), 2) if not each.good]
    assert [each.text for each in found if "cannot be opened, so their settings are unknown" in each.text]
