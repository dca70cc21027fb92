"""The rows of a run end with its motion, wherever the blocks end."""

import numpy as np
import pytest

from station.control.task import Phase
from station.recording.recorder import RunRows

#: Phases of a run row by row: ready, motion to the start pose, rest, motion. AFTER: ready again, then an operator jogs
#: a joint.
PHASES = [Phase.NONE] * 3 + [Phase.APPROACHING] * 4 + [Phase.SETTLING] * 2 + [Phase.MOVING] * 5
AFTER = [Phase.NONE] * 3 + [Phase.JOGGING] * 4 + [Phase.NONE]


@pytest.fixture
def rows(make_rows, channels):
    made = make_rows(len(PHASES) + len(AFTER))
    channels.of(made, "phase")[:, 0] = PHASES + AFTER
    return made


@pytest.mark.parametrize("size", [1, 3, 100])
def test_rows_after_the_motion_are_not_part_of_the_run(rows, channels, size):
    of_run = RunRows(channels)
    taken = np.concatenate([of_run.take(rows[first : first + size]) for first in range(0, len(rows), size)])

    assert np.array_equal(taken, rows[: len(PHASES)])
    assert of_run.over
    assert of_run.motion_start == rows[PHASES.index(Phase.MOVING), 0]


def test_jogging_before_a_run_does_not_end_its_rows(rows, channels):
    before = rows[len(PHASES) :]
    of_run = RunRows(channels)

    assert np.array_equal(of_run.take(before), before)
    assert np.array_equal(of_run.take(rows), rows[: len(PHASES)])


def test_a_run_that_was_stopped_before_its_start_pose_has_no_motion_rows(rows, channels):
    channels.of(rows, "phase")[5:] = Phase.NONE
    of_run = RunRows(channels)

    assert np.array_equal(of_run.take(rows), rows[:5])
    assert of_run.motion_start is None
