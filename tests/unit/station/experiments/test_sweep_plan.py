"""Settings of a sweep from `--set` options."""

import math

import pytest

from station.config.strict import ConfigError
from station.experiments.sweep_plan import nested, settings


def test_sweep_settings_combine_all_values_in_the_given_order():
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
        (
            'a=inf,"not a, word",-1e-3,dual_layer,[x, -inf]',
            [math.inf, "not a, word", -1e-3, "dual_layer", ["x", -math.inf]],
        ),
    ],
)
def test_values_of_set_options_are_toml_and_words_need_no_quotes(option, values):
    assert [setting[0][1] for setting in settings([option])] == values


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["controller.k1"], "write KEY=VALUE"),
        (["=1"], "write KEY=VALUE"),
        (["a="], "write KEY=VALUE"),
        (["a=1,,2"], "'1,,2' is not a list of TOML values"),
        (["a=1 2"], "'1 2' is not a list of TOML values"),
        (["a=1", "a=2"], "'a' is set twice"),
    ],
)
def test_an_invalid_set_option_of_a_sweep_is_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        settings(options)


def test_dotted_keys_of_a_sweep_setting_become_nested_tables():
    assert nested((("controller.k1", 1), ("controller.k2", 2), ("lab", "x"))) == {
        "controller": {"k1": 1, "k2": 2},
        "lab": "x",
    }
    with pytest.raises(ConfigError, match="'lab' is set to a value"):
        nested((("lab", "x"), ("lab.tracker", 1)))
    with pytest.raises(ConfigError, match="keys below 'lab' are set too"):
        nested((("lab.tracker", 1), ("lab", "x")))
