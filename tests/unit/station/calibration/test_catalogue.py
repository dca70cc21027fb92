"""The expected duration of a calibration procedure matches the number of measurements that it makes."""

import pytest

from station.calibration.catalogue import DEFAULT_WEIGHTS_N, PROCEDURES, known_weights
from station.calibration.procedures import Effort
from station.config.controllers import Present
from station.config.robots import load_robot
from station.config.strict import ConfigError


def test_expected_duration_of_a_procedure_increases_with_weights_and_effort():
    tubes, usual = PROCEDURES["tubes"], len(DEFAULT_WEIGHTS_N)
    assert tubes.expected(1.0, usual) == pytest.approx(1150.0)
    assert tubes.expected(0.5, usual) == pytest.approx(575.0)
    # The expected duration is proportional to the number of poses; each weight adds its share of poses.
    poses = [Effort(weights=(0.1,) * count).steps() for count in (1, 2, 3)]
    for count, steps in zip((1, 2, 3), poses, strict=True):
        assert tubes.expected(1.0, count) == pytest.approx(1150.0 * steps / poses[1], rel=0.02)


@pytest.mark.parametrize("name", ["axes", "latency", "tracker"])
def test_weights_do_not_change_the_duration_of_a_procedure_without_weights(name):
    offer = PROCEDURES[name]
    assert not offer.weighs
    assert offer.expected(1.0, 5) == offer.expected(1.0, 1) == offer.seconds


def test_procedures_name_the_device_that_a_bench_lacks():
    tracker_only = Present(tracker=True, sensors=False)
    assert {name for name, offer in PROCEDURES.items() if offer.missing(tracker_only)} == {"force"}
    assert PROCEDURES["force"].missing(tracker_only) == "needs force sensors"
    assert {offer.missing(Present(tracker=False)) for offer in PROCEDURES.values()} == {"needs a tracker"}
    assert not any(offer.missing(Present()) for offer in PROCEDURES.values())


def test_effort_does_not_change_the_duration_of_a_fixed_procedure():
    assert PROCEDURES["axes"].expected(2.0, 2) == PROCEDURES["axes"].seconds


def test_known_weights_are_lighter_for_a_soft_robot_and_heavier_ones_are_refused():
    paper = load_robot("paper")
    assert known_weights(paper) == (0.25, 0.5)
    soft = paper.model_copy(update={"max_force": 0.2})
    assert known_weights(soft) == (0.075, 0.15)
    assert known_weights(soft, (0.2, 0.1)) == (0.2, 0.1)
    with pytest.raises(ConfigError, match=r"weight of 0\.25 N is more than the 0\.2 N that 'paper' bears"):
        known_weights(soft, (0.1, 0.25))
