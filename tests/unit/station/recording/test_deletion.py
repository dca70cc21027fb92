"""Age of deletions, also after changes of the clock, and removal of deleted runs."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.recording.deletion import (
    PLAUSIBLE_SPAN_S,
    RECORD_FILE,
    RESTARTED_SPAN_S,
    TRASH_SPAN_S,
    Deletion,
    deletion_now,
    is_due,
    remove_due,
    write_deletion,
)

DAY = 24 * 3600.0
NOW = Deletion(run="a", time=1.8e9, boot="this", since_boot=50.0 * DAY)


@given(jump=st.floats(-1e10, 1e10), age=st.floats(0.0, 40.0 * DAY))
def test_changes_of_the_clock_do_not_change_the_age_until_the_computer_restarts(jump, age):
    deleted = NOW.model_copy(update={"time": NOW.time - age - jump, "since_boot": NOW.since_boot - age})
    assert is_due(deleted, NOW) == (age > TRASH_SPAN_S)


@given(age=st.floats(-1e10, RESTARTED_SPAN_S) | st.floats(1.001 * PLAUSIBLE_SPAN_S, 1e10))
def test_after_a_restart_a_clock_wrong_by_days_or_by_years_does_not_end_the_time_to_restore_a_run(age):
    assert not is_due(NOW.model_copy(update={"time": NOW.time - age, "boot": "before"}), NOW)


def test_after_a_restart_a_run_that_was_deleted_weeks_ago_is_due():
    assert is_due(NOW.model_copy(update={"time": NOW.time - 2.0 * RESTARTED_SPAN_S, "boot": "before"}), NOW)


def write(folder, **changes):
    folder.mkdir(parents=True)
    (folder / RECORD_FILE).write_text(json.dumps(deletion_now(folder.name).model_dump() | changes))


def test_an_implausible_age_starts_again(tmp_path):
    write(tmp_path / "deleted" / "run", time=1.0, boot="before")
    remove_due(tmp_path / "deleted")
    known = Deletion.model_validate_json((tmp_path / "deleted" / "run" / RECORD_FILE).read_bytes())
    assert known.boot == deletion_now("run").boot
    assert known.time > 1e9


OLD = {"since_boot": -1e9, "time": 1.0}


def test_only_runs_with_a_record_of_their_own_deletion_are_removed(tmp_path):
    trash = tmp_path / "deleted"
    write(trash / "mine", **OLD)
    write(trash / "copied", **OLD, run="mine")
    (trash / "thesis").mkdir()
    (trash / "file").write_text("")
    (trash / "damaged").mkdir()
    (trash / "damaged" / RECORD_FILE).write_text("{")
    write(tmp_path / "elsewhere", **OLD, run="link")
    (trash / "link").symlink_to(tmp_path / "elsewhere")
    (trash / "linked record").mkdir()
    write(tmp_path / "record", **OLD, run="linked record")
    (trash / "linked record" / RECORD_FILE).symlink_to(tmp_path / "record" / RECORD_FILE)
    remove_due(trash)
    left = sorted(path.name for path in trash.iterdir())
    assert left == ["copied", "damaged", "file", "link", "linked record", "thesis"]
    assert (tmp_path / "elsewhere" / RECORD_FILE).exists()


@pytest.mark.parametrize("kind", ["missing", "file", "link"])
def test_a_trash_that_is_no_folder_is_left_alone(tmp_path, kind):
    write(tmp_path / "elsewhere" / "run", **OLD)
    if kind == "file":
        (tmp_path / "deleted").write_text("")
    elif kind == "link":
        (tmp_path / "deleted").symlink_to(tmp_path / "elsewhere")
    remove_due(tmp_path / "deleted")
    assert (tmp_path / "elsewhere" / "run").exists()


def test_a_new_deletion_is_not_due(tmp_path):
    (tmp_path / "deleted" / "run").mkdir(parents=True)
    write_deletion(tmp_path / "deleted" / "run")
    remove_due(tmp_path / "deleted")
    assert (tmp_path / "deleted" / "run").exists()
