"""How long a procedure is said to take, against the measurements that it really makes."""

import pytest

from station.calibration.catalogue import OFFERS, WEIGHTS
from station.calibration.procedures import Effort


def test_more_weights_and_more_effort_take_longer():
    tubes, usual = OFFERS["tubes"], len(WEIGHTS)
    assert tubes.expected(1.0, usual) == pytest.approx(1150.0)
    assert tubes.expected(0.5, usual) == pytest.approx(575.0)
    # By the poses that it measurements: a weight has its share of them.
    poses = [Effort(weights=(0.1,) * count).steps() for count in (1, 2, 3)]
    for count, steps in zip((1, 2, 3), poses, strict=True):
        assert tubes.expected(1.0, count) == pytest.approx(1150.0 * steps / poses[1], rel=0.02)


@pytest.mark.parametrize("name", ["axes", "latency", "tracker"])
def test_weights_are_nothing_to_a_procedure_that_asks_for_none(name):
    offer = OFFERS[name]
    assert not offer.weighs
    assert offer.expected(1.0, 5) == offer.expected(1.0, 1) == offer.seconds


def test_a_fixed_procedure_takes_no_effort():
    assert OFFERS["axes"].expected(2.0, 2) == OFFERS["axes"].seconds
