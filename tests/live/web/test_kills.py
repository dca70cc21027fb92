"""A station that is killed in the middle of a run leaves a recording that opens."""

import pytest

from tests.harness.kill_recordings import kill_station


@pytest.fixture
def grace() -> float:
    """What the killed station has started ends by itself."""
    return 10.0


@pytest.mark.parametrize(("victim", "after"), [("control", 0.4), ("control", 2.3), ("station", 1.1), ("all", 1.7)])
def test_kill_9_in_the_middle_of_a_run_loses_no_row_that_is_older_than_300_ms(tmp_path, victim, after):
    assert kill_station(tmp_path / "data", victim, after).rows > 0
