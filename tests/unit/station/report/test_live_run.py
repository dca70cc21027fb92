"""Of a live run reports show the motion, from its start on, whatever its summary knows of it."""

import numpy as np
import pytest

from station.control.task import Phase
from station.report.run import read_run


@pytest.fixture
def rows(make_rows, channels):
    """The way to the start, the rest there, and 50 rows of a motion."""
    made = make_rows(100, first=500)
    channels.of(made, "phase")[:, 0] = [Phase.APPROACHING] * 30 + [Phase.SETTLING] * 20 + [Phase.MOVING] * 50
    return made


def test_a_run_that_was_recovered_and_has_no_summary_begins_with_its_motion(rows, recorded):
    (case,) = read_run(recorded(rows, "run").parent).cases

    assert case.moved
    assert len(case.rows) == 50
    assert case.time == pytest.approx(0.002 * np.arange(50))
    assert case.of("tip_time")[0, 0] == rows[50, 5] - rows[50, 0]


def test_a_run_that_never_began_its_motion_is_shown_and_told_from_one_that_did(rows, recorded):
    (case,) = read_run(recorded(rows[:50], "run").parent).cases

    assert not case.moved
    assert len(case.rows) == 50
