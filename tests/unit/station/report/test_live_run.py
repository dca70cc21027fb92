"""Reports of a live run show the motion from its start on, with and without a summary."""

import numpy as np
import pytest

from station.control.task import Phase
from station.recording.read import open_case
from station.report.facts import head
from station.report.run import read_run


@pytest.fixture
def rows(make_rows, channels):
    """Return rows of the approach to the start pose (30), of the rest there (20), and of a motion (50)."""
    made = make_rows(100, first=500)
    channels.of(made, "phase")[:, 0] = [Phase.APPROACHING] * 30 + [Phase.SETTLING] * 20 + [Phase.MOVING] * 50
    return made


def test_a_report_of_a_recovered_run_has_rows_from_the_start_of_its_motion(rows, recorded):
    (case,) = read_run(recorded(rows, "run").parent).cases

    assert case.moved
    assert len(case.rows) == 50
    assert case.time == pytest.approx(0.002 * np.arange(50))
    assert case.of("tip_time")[0, 0] == rows[50, 5] - rows[50, 0]


def test_a_report_names_the_damaged_rows_of_a_recording(make_rows, channels, recorded):
    rows = make_rows(300)
    channels.of(rows, "force_variance")[:] = 0.01
    path = recorded(rows, "run")
    with open_case(path) as case:
        assert [len(block) for block in case.blocks()] == [100, 100, 100]
    content = bytearray(path.read_bytes())
    content[content.index(b"zstd", len(content) // 3) + 100] ^= 1
    path.write_bytes(bytes(content))
    run = read_run(path.parent)

    assert len(run.cases[0].rows) == 200
    assert any("100 rows are damaged and missing: 0." in text for text in head(run))


def test_a_report_of_a_run_without_a_motion_has_all_rows_and_states_that_it_did_not_move(rows, recorded):
    (case,) = read_run(recorded(rows[:50], "run").parent).cases

    assert not case.moved
    assert len(case.rows) == 50
