"""An invalid configuration file is refused at the start; the error names file, line, key, value and expected value."""

import pytest

from station.config.robots import load_robot
from station.config.strict import PRESETS, ConfigError
from station.experiments.experiment import load_experiment
from station.service.station_file import load_station

#: Start pose with a typical mistake: its translation is in millimetres, but the key is in metres.
PARK = """[park]
outer_rotation = 0.0
inner_rotation = 0.0
inner_translation = -100.0
"""
STAGES = '[devices.stages]\ndriver = "zaber"\nport = "/dev/x"\n'
PORTLESS = """seed = 1
[devices.stages]
driver = "zaber"
[devices.tracker]
driver = "none"
[devices.sensors]
driver = "netft"
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("seed = 1\nspeed = 3\n", "unknown key 'speed' (line 2)"),
        ("\n\nseed = -1\n", "seed = -1: Input should be greater than or equal to 0 (line 3)"),
        ("seed = nan\n", "seed = nan: Input should be a valid integer (line 1)"),
        ('fifo = "yes"\n', "fifo = 'yes': Input should be a valid boolean (line 1)"),
        ("[margins]\nuncertainty = 2.0\n", "margins.uncertainty = 2.0: Input should be less than or equal to 0.3"),
        ("[overruns]\nhold_in_a_row = 0\n", "overruns.hold_in_a_row = 0: Input should be greater than or equal to 1"),
        ('on_operator_loss = "stay"\n', "on_operator_loss = 'stay': Input should be 'continue' or 'hold' (line 1)"),
        (PARK, "inner_translation -100 m is outside -0.13 ... -0.005 m (its travel)"),
        ("[controller]\nk1 = 100.0\n", "K1"),
        (PORTLESS, "devices.stages.port is missing: outer_rotation has no port; set one for it or for the chain"),
        ('[devices.tracker]\ndriver = "aurora"\n', "'devices.stages' is missing (line 1)"),
        ('without = ["sensors"]\n' + STAGES, "without = ['sensors']: leave out the tables of real devices instead"),
        ("seed = [1\n", "not valid TOML"),
    ],
)  # fmt: skip
def test_error_of_an_invalid_station_file_names_line_key_value_and_expected_value(write, text: str, said: str) -> None:
    path = write(text)
    with pytest.raises(ConfigError) as refusal:
        load_station(path).bench()

    assert str(refusal.value).startswith(f"{path}: ")
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_error_of_an_invalid_robot_or_experiment_file_names_line_and_key(write) -> None:
    robot = (PRESETS / "robots" / "paper.toml").read_text(encoding="utf-8")
    bad = robot.replace("outer_diameter = ", "outer_diameter = -", 1)
    line = 1 + bad[: bad.index("outer_diameter = -")].count("\n")
    bad = bad.replace("outer_diameter = -", "outer_diametre = ", 1)
    with pytest.raises(ConfigError, match=rf"unknown key 'tubes.0.outer_diametre'.* \(line {line}\)"):
        load_robot(str(write(bad)))

    experiment = (PRESETS / "experiments" / "fig10.toml").read_text(encoding="utf-8")
    with pytest.raises(ConfigError, match=r"case '\w+': unknown key 'loud'.* \(line 1\)"):
        load_experiment(str(write("loud = true\n" + experiment)))
