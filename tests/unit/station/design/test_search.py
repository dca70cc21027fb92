"""The search and what it keeps."""

import json

import pytest

from station.config.strict import ConfigError
from station.design.candidates import Candidates
from station.design.search import Stopped, planned, search
from station.design.study import load_study
from station.recording.label import RecordingError

STUDY = """title = "bowl"
[task]
points = [[0.02459, -0.04154, 0.19392]]
forces = [[0.5, 0.0, 0.0]]
[[parameters]]
key = "inner.sections.2.curvature"
lower = 1.0
upper = 9.0
[[parameters]]
key = "outer.sections.2.curvature"
lower = 1.0
upper = 9.0
[search]
population = 4
generations = 12
"""


@pytest.fixture
def study(tmp_path):
    (tmp_path / "bowl.toml").write_text(STUDY)
    return load_study(str(tmp_path / "bowl.toml"))


def bowl(candidates, keep):
    """An engine for which curvatures of 7 and 3 are best."""
    for one in candidates:
        x, y = one.parameters
        keep({"parameters": [x, y], "cost": (x - 7.0) ** 2 + (y - 3.0) ** 2})


def until(count):
    """The same, which Ctrl-C ends after so many."""
    left = [count]

    def engine(candidates, keep):
        some = candidates[: left[0]]
        left[0] -= len(some)
        bowl(some, keep)

    return engine


def searched(study, folder, engine=bowl):
    with Candidates(folder, study) as candidates:
        return search(study, candidates, engine, lambda _: None)


def test_it_begins_with_the_robot_as_it_is_and_finds_the_bottom(study, tmp_path):
    lines = searched(study, tmp_path / "a")
    assert len(lines) == planned(study)
    assert lines[0]["parameters"] == [4.0, 4.0]
    best = min(lines, key=lambda line: line["cost"])
    assert best["parameters"] == pytest.approx([7.0, 3.0], abs=0.3)
    assert all(1.0 <= value <= 9.0 for line in lines for value in line["parameters"])


def test_one_that_was_stopped_twice_goes_on_to_the_same_end(study, tmp_path):
    whole = searched(study, tmp_path / "whole")
    for _ in range(2):
        with pytest.raises(Stopped, match="the same command goes on"):
            searched(study, tmp_path / "parts", until(30))
    kept = (tmp_path / "parts" / "candidates.jsonl").read_bytes()
    assert kept.count(b"\n") == 1 + 60
    # Killed in the middle of a line.
    (tmp_path / "parts" / "candidates.jsonl").write_bytes(kept[:-20])
    looked_at = []

    def counted(candidates, keep):
        looked_at.extend(candidates)
        bowl(candidates, keep)

    assert searched(study, tmp_path / "parts", counted) == whole
    lines = (tmp_path / "parts" / "candidates.jsonl").read_text().splitlines()
    assert len({tuple(json.loads(line)["parameters"]) for line in lines[1:]}) == len(lines) - 1
    assert len(looked_at) == len(lines) - 1 - 59


def test_another_search_is_not_mixed_in(study, tmp_path):
    searched(study, tmp_path / "a")
    (tmp_path / "bowl.toml").write_text(STUDY.replace("generations = 12", "generations = 13"))
    with pytest.raises(ConfigError, match=r"another search is kept there \(study differ\)"):
        searched(load_study(str(tmp_path / "bowl.toml")), tmp_path / "a")


def test_two_do_not_search_in_one_folder(study, tmp_path):
    with Candidates(tmp_path, study), pytest.raises(RecordingError, match="another process searches there"):
        Candidates(tmp_path, study)


def test_a_file_that_is_no_list_is_not_written_over(study, tmp_path):
    (tmp_path / "candidates.jsonl").write_text("notes\n")
    with pytest.raises(RecordingError, match="line 1: no JSON"):
        Candidates(tmp_path, study)
    assert (tmp_path / "candidates.jsonl").read_text() == "notes\n"
