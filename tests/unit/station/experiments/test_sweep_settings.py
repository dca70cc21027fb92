"""What `--set` says."""

import pytest

from station.config.strict import ConfigError
from station.experiments.sweep_settings import nested, settings


def test_every_combination_of_values_in_the_order_given():
    assert settings(["controller.k1=1,2.5", "lab=default,distorted"]) == [
        (("controller.k1", 1), ("lab", "default")),
        (("controller.k1", 1), ("lab", "distorted")),
        (("controller.k1", 2.5), ("lab", "default")),
        (("controller.k1", 2.5), ("lab", "distorted")),
    ]
    assert settings([]) == [()]


@pytest.mark.parametrize(
    ("option", "values"),
    [
        ("a=true,false", [True, False]),
        ("a=1e-3", [0.001]),
        ("a=[0, 0.001, 0], [1, 0, 0]", [[0, 0.001, 0], [1, 0, 0]]),
        ('a="x, y",z', ["x, y", "z"]),
        ("a=my-lab,labs/own.toml", ["my-lab", "labs/own.toml"]),
        ("a={ kind = 'hold' }", [{"kind": "hold"}]),
    ],
)
def test_values_are_those_of_toml_and_plain_words_are_texts(option, values):
    assert [setting[0][1] for setting in settings([option])] == values


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["controller.k1"], "write KEY=VALUE"),
        (["=1"], "write KEY=VALUE"),
        (["a=1,,2"], "a value is missing between the commas"),
        (["a=1 2"], "'1 2' is no value"),
        (["a=1", "a=2"], "'a' was set before"),
    ],
)
def test_what_is_no_setting_is_refused(options, said):
    with pytest.raises(ConfigError, match=said):
        settings(options)


def test_dotted_keys_become_tables():
    assert nested((("controller.k1", 1), ("controller.k2", 2), ("lab", "x"))) == {
        "controller": {"k1": 1, "k2": 2},
        "lab": "x",
    }
    with pytest.raises(ConfigError, match="'lab' has a value of its own"):
        nested((("lab", "x"), ("lab.tracker", 1)))
    with pytest.raises(ConfigError, match="parts of it are set too"):
        nested((("lab.tracker", 1), ("lab", "x")))
