"""Shared memory between the processes: rows in order, and a ground truth that is never read during a write."""

import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from core.control.setpoint_request import SetpointRequest
from station.control.ring import RING_ROWS, SEGMENT_FOLDER, SEGMENT_PREFIX, STUCK, Ring, clear_left_behind
from station.control.task import StreamRequest
from station.devices.interfaces import GroundTruth


@pytest.fixture
def ring() -> Iterator[Ring]:
    ring = Ring(4)
    yield ring
    ring.close(remove=True)


def a_truth(number: float) -> GroundTruth:
    return GroundTruth(np.full(3, number), np.full(3, -number))


def test_ring_without_a_lab_has_no_ground_truth(ring: Ring) -> None:
    assert ring.truth() is None


def test_ring_returns_the_latest_ground_truth_of_the_lab(ring: Ring) -> None:
    for number in (1.0, 2.0):
        ring.publish_ground_truth(a_truth(number))
        truth = ring.truth()
        assert truth is not None
        assert truth.tip.tolist() == [number] * 3
        assert truth.force.tolist() == [-number] * 3


def test_ground_truth_in_the_ring_contains_the_direction_and_the_target_if_there_are_any(ring: Ring) -> None:
    ring.publish_ground_truth(a_truth(1.0))
    alone = ring.truth()
    ring.publish_ground_truth(a_truth(1.0)._replace(direction=np.array([0.0, 0.6, 0.8]), target=np.full(3, 7.0)))
    following = ring.truth()
    assert alone is not None
    assert alone.target is None
    assert following is not None
    assert following.direction is not None
    assert following.target is not None
    assert following.direction.tolist() == [0.0, 0.6, 0.8]
    assert following.target.tolist() == [7.0] * 3


def test_previous_ground_truth_is_read_during_a_write(ring: Ring) -> None:
    ring.publish_ground_truth(a_truth(1.0))
    ring.truth()
    # The odd count simulates that the lab's process is interrupted during a write.
    ring._truth[0] += 1.0
    ring._truth[1] = 99.0
    truth = ring.truth()
    assert truth is not None
    assert truth.tip.tolist() == [1.0] * 3


def a_setpoint(number: float) -> SetpointRequest:
    return SetpointRequest(np.full(3, number), np.full(3, -number), number, 0.1, np.array([0.0, 0.6, -0.8]))


def test_ring_returns_the_newest_setpoint_request_of_the_present_run(ring: Ring) -> None:
    assert ring.request(1) is None
    for number in range(10_000):
        ring.write_request(StreamRequest(1, a_setpoint(float(number))))
    request = ring.request(1)
    assert request is not None
    assert request.setpoint is not None
    assert request.setpoint.position is not None
    assert request.setpoint.position.tolist() == [9999.0] * 3
    assert request.setpoint.velocity.tolist() == [-9999.0] * 3
    assert (request.setpoint.time, request.setpoint.extrapolation) == (9999.0, 0.1)
    assert request.setpoint.direction is not None
    assert request.setpoint.direction.tolist() == [0.0, 0.6, -0.8]
    ring.write_request(StreamRequest(1, a_setpoint(1.0)._replace(direction=None)))
    request = ring.request(1)
    assert request is not None
    assert request.setpoint is not None
    assert request.setpoint.direction is None
    assert ring.request(2) is None
    ring.write_request(StreamRequest(1, None))
    assert ring.request(1) == StreamRequest(1, None)


def test_previous_setpoint_request_is_read_during_a_write(ring: Ring) -> None:
    ring.write_request(StreamRequest(1, a_setpoint(1.0)))
    ring.request(1)
    # The odd count simulates that the station process is interrupted during a write.
    ring._request_cells[0] += 1.0
    ring._request_cells[3] = 99.0
    request = ring.request(1)
    assert request is not None
    assert request.setpoint is not None
    assert request.setpoint.position is not None
    assert request.setpoint.position.tolist() == [1.0] * 3


def test_stuck_robot_is_reported_in_the_ring(ring: Ring) -> None:
    ring.publish_ground_truth(a_truth(1.0), stuck=True)
    assert ring.counters[STUCK]
    ring.publish_ground_truth(a_truth(1.0))
    assert not ring.counters[STUCK]


def test_ring_returns_rows_in_order_and_counts_overwritten_rows_as_missed(ring: Ring) -> None:
    for number in range(RING_ROWS + 10):
        ring.write(np.full(4, float(number)))
    rows, since, missed = ring.read(0)
    assert since == RING_ROWS + 10
    assert missed == since - len(rows)
    assert rows[:, 0].tolist() == [float(number) for number in range(missed, since)]
    assert ring.read(since)[0].shape == (0, 4)


def test_only_shared_memory_segments_of_killed_stations_are_removed(ring: Ring) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = SEGMENT_FOLDER / f"{SEGMENT_PREFIX}{gone.pid}_0123abcd"
    others = [
        SEGMENT_FOLDER / f"{SEGMENT_PREFIX}1_0123abcd",
        SEGMENT_FOLDER / f"{SEGMENT_PREFIX}nobody_{gone.pid}",
        SEGMENT_FOLDER / f"{SEGMENT_PREFIX}{gone.pid}_notes",
        SEGMENT_FOLDER / f"{SEGMENT_PREFIX}{'9' * 30}_0123abcd",
        SEGMENT_FOLDER / f"psm_{gone.pid}",
    ]
    try:
        for path in (left, *others):
            path.touch()
        clear_left_behind()
        assert not left.exists()
        assert all(path.exists() for path in others)
        assert (SEGMENT_FOLDER / ring.name).exists()
    finally:
        for path in (left, *others):
            path.unlink(missing_ok=True)
