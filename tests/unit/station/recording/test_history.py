"""The history of stored runs."""

import json
import multiprocessing
import os
import shutil
import time

import pytest

from station.recording.deletion import RECORD_FILE, TRASH, TRASH_SPAN_S
from station.recording.history import MAX_NOTES_CHARS, NOTES_FILE, RunError, RunHistory, resolve_run
from station.recording.run_folder import RunFolder


@pytest.fixture
def history(tmp_path, recorded, make_rows):
    """Return three runs, `first` with a recording, `second` and the newest, `third`, and an unfinished one."""
    runs = tmp_path / "runs"
    recording = recorded(make_rows(10), "regulation")
    for number, (name, experiment, label) in enumerate(
        [("first", "fig7", "complete"), ("third", "fig10", "complete"), ("second", "fig7", "stopped")]
    ):
        folder = RunFolder(runs, name)
        if name == "first":
            folder.case("regulation").write_bytes(recording.read_bytes())
        started = {"first": 1.0, "second": 2.0, "third": 3.0}[name]
        folder.finish({"experiment": experiment, "label": label, "started": started, "title": f"Title {number}"})
    RunFolder(runs, "unfinished").let_go()
    return RunHistory(runs)


def ids(runs):
    return [run.id for run in runs]


def test_stored_runs_are_listed_newest_first(history):
    assert ids(history.runs()) == ["third", "second", "first"]
    first = history.runs()[-1]
    assert (first.experiment, first.label, first.cases, first.notes) == ("fig7", "complete", ("regulation",), "")
    assert first.size > 1000


def test_stored_runs_are_filtered_by_experiment_label_and_text(history):
    assert ids(history.runs(experiment="fig7")) == ["second", "first"]
    assert ids(history.runs(experiment="fig7", label="complete")) == ["first"]
    assert ids(history.runs(text="TITLE 1")) == ["third"]
    history.annotate("second", notes="The coil was loose.", tags=["morning"])
    assert ids(history.runs(text="loose")) == ["second"]
    assert ids(history.runs(text="MORNING")) == ["second"]
    assert ids(history.runs(text="fig7 loose")) == []


def test_a_missing_folder_of_runs_has_no_runs(tmp_path):
    assert RunHistory(tmp_path / "none").runs() == []
    with pytest.raises(RunError, match="the folder has no runs yet"):
        RunHistory(tmp_path / "none").find("latest")


def test_a_run_with_a_start_in_the_future_is_not_the_latest(history, tmp_path):
    folder = RunFolder(tmp_path / "runs", "future")
    folder.finish({"experiment": "fig7", "label": "complete", "started": time.time() + 1e6, "title": "Title"})
    assert ids(history.runs()) == ["third", "second", "first", "future"]
    assert history.find("latest").name == "third"


@pytest.mark.parametrize("name", ["", ".", "..", "../runs/first", "first/", "/etc", "unfinished.partial", "first\0"])
def test_a_run_name_never_points_outside_the_folder(history, name):
    for ask in (history.find, history.run, history.recording, lambda n: history.delete(n, n)):
        with pytest.raises(RunError, match="not one of the runs"):
            ask(name)
    assert ids(history.runs()) == ["third", "second", "first"]


def test_a_link_in_the_folder_of_runs_is_not_listed_as_a_run(history, tmp_path):
    (tmp_path / "runs" / "link").symlink_to(tmp_path / "runs" / "first")
    assert ids(history.runs()) == ["third", "second", "first"]


@pytest.mark.parametrize("name", [".Trash-1000", "._first", ".#first", ".~lock.first#"])
def test_a_hidden_folder_is_not_a_run(history, tmp_path, name):
    shutil.copytree(tmp_path / "runs" / "first", tmp_path / "runs" / name)
    assert ids(history.runs()) == ["third", "second", "first"]
    with pytest.raises(RunError, match="not one of the runs"):
        history.delete(name, name)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_star_keeps_notes_that_an_editor_saved_with_a_byte_order_mark(history, tmp_path, encoding):
    (tmp_path / "runs" / "first" / NOTES_FILE).write_text('{"notes": "äöü", "mine": 1}', encoding=encoding)
    assert history.annotate("first", starred=True).notes == "äöü"
    kept = (tmp_path / "runs" / "first" / NOTES_FILE).read_text(encoding="utf-8")
    assert json.loads(kept) == {"notes": "äöü", "mine": 1, "starred": True}


def test_notes_about_a_run_are_stored_and_replaced(history):
    assert history.annotate("first", notes="one").notes == "one"
    assert history.annotate("first", notes="zwei äöü\n").notes == "zwei äöü\n"
    assert history.run("first").notes == "zwei äöü\n"
    with pytest.raises(RunError, match=f"at most {MAX_NOTES_CHARS}"):
        history.annotate("first", notes="x" * (MAX_NOTES_CHARS + 1))
    assert history.run("first").notes == "zwei äöü\n"
    assert history.annotate("first", title="my circle").title == "my circle"
    assert history.annotate("first", title="").title == "Title 0"  # the recorded title


def test_a_run_is_deleted_only_when_its_name_is_confirmed(history):
    for confirm in ("", "second", "latest"):
        with pytest.raises(RunError, match="confirm"):
            history.delete("first", confirm)
    with pytest.raises(RunError, match="confirm"):
        history.delete("latest", "latest")
    history.delete("first", "first")
    assert ids(history.runs()) == ["third", "second"]


def test_a_deleted_run_is_restored_with_everything(history, tmp_path):
    before = history.annotate("first", notes="one", tags=["coil 2"])
    history.delete("first", "first")
    assert ids(history.deleted().runs()) == ["first"]
    with pytest.raises(RunError, match="not one of the runs"):
        history.find("first")
    assert history.restore("first") == before
    assert not (tmp_path / "runs" / "first" / RECORD_FILE).exists()
    assert ids(history.deleted().runs()) == []
    assert history.recording("first").name == "regulation.mcap"


def make_older(folder, span):
    """Change the record of a deletion as if the run had been deleted `span` [s] earlier, in the same boot."""
    record = json.loads((folder / RECORD_FILE).read_text())
    changes = {key: record[key] - span for key in ("time", "since_boot")}
    (folder / RECORD_FILE).write_text(json.dumps(record | changes))


def test_a_deletion_and_a_purge_remove_runs_that_were_deleted_more_than_a_day_ago(history, tmp_path):
    history.delete("first", "first")
    history.delete("second", "second")
    make_older(tmp_path / "runs" / TRASH / "first", TRASH_SPAN_S + 60.0)
    history.delete("third", "third")
    assert ids(history.deleted().runs()) == ["third", "second"]
    make_older(tmp_path / "runs" / TRASH / "second", 30.0 * TRASH_SPAN_S)
    history.purge()
    assert ids(history.deleted().runs()) == ["third"]


def test_a_linked_trash_is_neither_used_nor_emptied(history, tmp_path):
    other = tmp_path / "other"
    history.delete("first", "first")
    make_older(tmp_path / "runs" / TRASH / "first", 30.0 * TRASH_SPAN_S)
    (tmp_path / "runs" / TRASH).rename(other)
    (tmp_path / "runs" / TRASH).symlink_to(other)
    history.purge()
    assert history.deleted().runs() == []
    with pytest.raises(RunError, match="'deleted' is a link or a file, not a folder"):
        history.delete("second", "second")
    assert sorted(path.name for path in other.iterdir()) == ["first"]
    assert ids(history.runs()) == ["third", "second"]


def test_a_deleted_run_is_not_restored_over_another_run(history, tmp_path):
    history.delete("first", "first")
    (tmp_path / "runs" / "first").mkdir()
    with pytest.raises(RunError, match="runs/first exists"):
        history.restore("first")
    assert ids(history.deleted().runs()) == ["first"]


FIELDS = {"notes": "new", "title": "my circle", "starred": True, "tags": ("coil 2",)}


def annotate_all(folder, fields, rounds, together):
    """Set fields of the run `first` one after the other, repeatedly; their last values are those of `FIELDS`."""
    together.wait()
    for left in reversed(range(rounds)):
        for field in fields:
            value = ("x",) if field == "tags" else False if field == "starred" else "x"
            RunHistory(folder).annotate("first", **{field: value if left else FIELDS[field]})


def test_simultaneous_changes_of_a_run_are_all_kept(history, tmp_path):
    spawn = multiprocessing.get_context("spawn")
    pairs = [("notes", "title"), ("starred", "tags")]
    together = spawn.Barrier(len(pairs))
    arguments = [(tmp_path / "runs", fields, 50, together) for fields in pairs]
    writers = [spawn.Process(target=annotate_all, args=each) for each in arguments]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    run = history.run("first")
    assert {field: getattr(run, field) for field in FIELDS} == FIELDS
    assert sorted(path.name for path in (tmp_path / "runs" / "first").iterdir()) == [
        NOTES_FILE, "regulation.mcap", "summary.json",
    ]  # fmt: skip


def test_a_change_of_damaged_notes_is_refused_and_keeps_them(history, tmp_path):
    notes = tmp_path / "runs" / "first" / NOTES_FILE
    notes.write_text('{"notes": "all that I know", ')
    with pytest.raises(RunError, match=r"notes\.json is damaged; repair or remove it"):
        history.annotate("first", starred=True)
    assert "all that I know" in notes.read_text()


@pytest.mark.parametrize("added", [{"title": "two\nlines"}, {"tags": ["a\x1b[2J"]}, {"tags": ["a\u2028b"]}])
def test_control_characters_in_titles_and_tags_are_refused(history, added):
    with pytest.raises(RunError, match="control characters are not allowed"):
        history.annotate("first", **added)


@pytest.mark.parametrize(
    "added", [{"title": "x" * 121}, {"tags": ["x" * 41]}, {"tags": [str(number) for number in range(21)]}]
)
def test_too_long_titles_and_too_many_tags_are_refused_with_the_bound(history, added):
    with pytest.raises(RunError, match="at most"):
        history.annotate("first", **added)
    assert history.run("first").tags == ()


def test_a_recording_is_found_by_its_case(history):
    assert history.recording("first").name == "regulation.mcap"
    assert history.recording("first", "regulation").name == "regulation.mcap"
    with pytest.raises(RunError, match="'other' is not one of the cases: regulation"):
        history.recording("first", "other")
    with pytest.raises(RunError, match="no recording"):
        history.recording("second")


SPOILT = {
    "cut": "{",
    "no object": "[1]",
    "text for a time": '{"started": "yesterday"}',
    "a time beyond all floats": f'{{"started": 1{"0" * 400}}}',
    "more digits than are read": f'{{"started": 1{"0" * 5000}}}',
    "deep": "[" * 100_000,
    "half of a surrogate pair": '{"title": "\\ud800"}',
    "half of one as a key": '{"cases": {"\\udfff": 1}}',
    "not finite": '{"started": NaN, "cases": {"x": [1e999, -Infinity]}}',
}


@pytest.mark.parametrize("text", SPOILT.values(), ids=SPOILT)
def test_a_run_with_an_invalid_summary_and_notes_file_is_listed(history, tmp_path, text):
    for file in ("summary.json", "notes.json"):
        (tmp_path / "runs" / "first" / file).write_text(text, encoding="utf-8")
    assert set(ids(history.runs())) == {"first", "second", "third"}
    assert history.run("first").cases == ("regulation",)
    assert history.run("first").model_dump_json()  # the run can be sent as JSON


def test_runs_and_recordings_with_names_that_are_not_utf_8_are_skipped(history, tmp_path):
    """A REST request cannot contain such a name of a folder or recording, and a reply cannot either."""
    second = tmp_path / "runs" / "second"
    (second / os.fsdecode(b"\xff.mcap")).write_bytes(b"")
    second.with_name("copy").mkdir()
    (second.with_name("copy") / "summary.json").write_text("{}")
    second.with_name("copy").rename(second.with_name(os.fsdecode(b"copy\xff")))
    assert ids(history.runs()) == ["third", "second", "first"]
    assert [run.model_dump_json() for run in history.runs()]
    with pytest.raises(RunError, match="not one of the cases"):
        history.recording("second", os.fsdecode(b"\xff"))


def test_resolve_run_accepts_a_folder_or_a_name(history, tmp_path, monkeypatch):
    runs = tmp_path / "runs"
    assert resolve_run(str(runs / "first"), runs) == runs / "first"
    assert resolve_run("second", runs) == runs / "second"
    (tmp_path / "latest").mkdir()
    monkeypatch.chdir(tmp_path)
    assert resolve_run("latest", runs) == runs / "third"
    with pytest.raises(RunError, match="'fourth' is not one of the runs in"):
        resolve_run("fourth", runs)
