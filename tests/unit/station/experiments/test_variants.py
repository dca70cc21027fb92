"""Cases of an experiment: the changes of each case, crossed choices, and changes to all cases."""

import re

import pytest

from station.config.strict import ConfigError
from station.experiments.experiment import load_experiment


def test_an_experiment_without_cases_is_one_case_with_the_name_of_its_file(write, short):
    experiment = load_experiment(str(write(short, "my run")))

    assert experiment.name == "my run"
    assert [case.name for case in experiment.cases] == ["my run"]
    assert experiment.source == short


def test_a_case_changes_only_the_keys_that_it_names(write, short):
    path = write(
        'lab = "ideal"\n' + short + "[cases.one]\n[cases.two]\nduration = 3.0\n"
        '[cases.two.trajectory]\nkind = "circle"\nradius = 0.01\nperiod = 8.0\n'
    )
    one, two = load_experiment(str(path)).cases

    assert (one.name, one.file.duration, one.file.trajectory.kind) == ("one", 1.0, "hold")
    assert (two.name, two.file.duration, two.file.trajectory.kind) == ("two", 3.0, "circle")
    assert one.lab == two.lab
    assert "ideal" in two.lab.title


CROSS = """
[cross.strategy.a.controller]
k1 = 1.0
[cross.strategy.b]
[cross.length.short]
[cross.length.long]
duration = 3.0
controller = { k2 = 4.0 }
"""


def test_crossed_choices_of_an_experiment_give_a_case_for_every_combination(write, short):
    cases = load_experiment(str(write(short + "[cases.first]\n" + CROSS))).cases

    assert [(case.name, case.file.duration, case.file.controller.k1, case.file.controller.k2) for case in cases] == [
        ("first", 1.0, 2.5, 2.5),
        ("a-short", 1.0, 1.0, 2.5),
        ("a-long", 3.0, 1.0, 4.0),
        ("b-short", 1.0, 2.5, 2.5),
        ("b-long", 3.0, 2.5, 4.0),
    ]


def test_an_error_in_a_crossed_choice_names_the_case(write, short):
    for wrong, message in (
        ("[cross.length.odd]\nbogus = 1\n", "case 'a-odd': unknown key 'bogus'"),
        ("[cross.length]\n", "cross.length = {}: "),
        ("[cross]\nlength = 3\n", "cross.length = 3: "),
    ):
        text = short + "[cross.strategy.a]\n" + wrong if "[cross]" not in wrong else short + wrong
        with pytest.raises(ConfigError, match=re.escape(message)):
            load_experiment(str(write(text)))


def test_an_experiment_with_too_many_cases_is_refused_before_they_are_checked(write, short):
    axes = "".join(f"[cross.axis{axis}.choice{number}]\n" for axis in range(6) for number in range(10))
    with pytest.raises(ConfigError, match=r"own\.toml: 1000000 cases; at most 1000"):
        load_experiment(str(write(short + axes)))


def test_changes_given_to_load_experiment_apply_to_every_case(write, short):
    path = write(short + "[cases.one]\nduration = 2.0\n[cases.two.controller]\nk1 = 4.0\nk2 = 4.0\n")
    one, two = load_experiment(str(path), {"duration": 0.5, "controller": {"k1": 1.0}}).cases

    assert (one.file.duration, two.file.duration) == (0.5, 0.5)
    assert (one.file.controller.k1, one.file.controller.k2) == (1.0, 2.5)
    assert (two.file.controller.k1, two.file.controller.k2) == (1.0, 4.0)
