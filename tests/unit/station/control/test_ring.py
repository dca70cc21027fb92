"""Shared memory between the processes: rows in order, and a truth that is never half of one and half of another."""

import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from core.control.leading import Wish
from station.control.led import Asked
from station.control.ring import PREFIX, ROWS, SEGMENTS, STUCK, Ring, clear_left_behind
from station.devices.interfaces import Truth


@pytest.fixture
def ring() -> Iterator[Ring]:
    ring = Ring(4)
    yield ring
    ring.close(remove=True)


def a_truth(number: float) -> Truth:
    return Truth(np.full(3, number), np.full(3, -number))


def test_without_a_lab_there_is_no_truth(ring: Ring) -> None:
    assert ring.truth() is None


def test_the_truth_is_what_the_lab_told_last(ring: Ring) -> None:
    for number in (1.0, 2.0):
        ring.publish_ground_truth(a_truth(number))
        truth = ring.truth()
        assert truth is not None
        assert truth.tip.tolist() == [number] * 3
        assert truth.force.tolist() == [-number] * 3


def test_the_direction_is_told_with_the_truth(ring: Ring) -> None:
    ring.publish_ground_truth(a_truth(1.0)._replace(direction=np.array([0.0, 0.6, 0.8])))
    truth = ring.truth()
    assert truth is not None
    assert truth.direction is not None
    assert truth.direction.tolist() == [0.0, 0.6, 0.8]


def test_a_target_is_told_where_there_is_one(ring: Ring) -> None:
    ring.publish_ground_truth(a_truth(1.0))
    alone = ring.truth()
    ring.publish_ground_truth(a_truth(1.0)._replace(target=np.full(3, 7.0)))
    beside = ring.truth()
    assert alone is not None
    assert alone.target is None
    assert beside is not None
    assert beside.target is not None
    assert beside.target.tolist() == [7.0] * 3


def test_while_the_lab_is_telling_what_it_told_before_holds(ring: Ring) -> None:
    ring.publish_ground_truth(a_truth(1.0))
    ring.truth()
    # The lab's process is interrupted in the middle of telling.
    ring._truth[0] += 1.0
    ring._truth[1] = 99.0
    truth = ring.truth()
    assert truth is not None
    assert truth.tip.tolist() == [1.0] * 3


def a_wish(number: float) -> Wish:
    return Wish(np.full(3, number), np.full(3, -number), number, 0.1, np.array([0.0, 0.6, -0.8]))


def test_of_all_that_was_asked_since_the_last_tick_the_newest_counts_and_of_that_run_alone(ring: Ring) -> None:
    assert ring.asked(1) is None
    for number in range(10_000):
        ring.ask(Asked(1, a_wish(float(number))))
    asked = ring.asked(1)
    assert asked is not None
    assert asked.wish is not None
    assert asked.wish.place is not None
    assert asked.wish.place.tolist() == [9999.0] * 3
    assert asked.wish.velocity.tolist() == [-9999.0] * 3
    assert (asked.wish.asked, asked.wish.goes_on) == (9999.0, 0.1)
    assert asked.wish.direction is not None
    assert asked.wish.direction.tolist() == [0.0, 0.6, -0.8]
    ring.ask(Asked(1, a_wish(1.0)._replace(direction=None)))
    asked = ring.asked(1)
    assert asked is not None
    assert asked.wish is not None
    assert asked.wish.direction is None
    assert ring.asked(2) is None
    ring.ask(Asked(1, None))
    assert ring.asked(1) == Asked(1, None)


def test_while_something_is_being_asked_what_was_asked_before_holds(ring: Ring) -> None:
    ring.ask(Asked(1, a_wish(1.0)))
    ring.asked(1)
    # The station's process is interrupted in the middle of asking.
    ring._wish[0] += 1.0
    ring._wish[3] = 99.0
    asked = ring.asked(1)
    assert asked is not None
    assert asked.wish is not None
    assert asked.wish.place is not None
    assert asked.wish.place.tolist() == [1.0] * 3


def test_a_robot_that_cannot_follow_is_told(ring: Ring) -> None:
    ring.publish_ground_truth(a_truth(1.0), stuck=True)
    assert ring.counters[STUCK]
    ring.publish_ground_truth(a_truth(1.0))
    assert not ring.counters[STUCK]


def test_rows_come_in_order_and_those_that_were_overwritten_are_counted(ring: Ring) -> None:
    for number in range(ROWS + 10):
        ring.write(np.full(4, float(number)))
    rows, since, missed = ring.read(0)
    assert since == ROWS + 10
    assert missed == since - len(rows)
    assert rows[:, 0].tolist() == [float(number) for number in range(missed, since)]
    assert ring.read(since)[0].shape == (0, 4)


def test_what_a_killed_station_left_is_removed_and_nobody_elses(ring: Ring) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = SEGMENTS / f"{PREFIX}{gone.pid}_0123abcd"
    others = [SEGMENTS / f"{PREFIX}1_0123abcd", SEGMENTS / f"{PREFIX}nobody_{gone.pid}", SEGMENTS / f"psm_{gone.pid}"]
    try:
        for path in (left, *others):
            path.touch()
        clear_left_behind()
        assert not left.exists()
        assert all(path.exists() for path in others)
        assert (SEGMENTS / ring.name).exists()
    finally:
        for path in (left, *others):
            path.unlink(missing_ok=True)
