"""The search and its stored candidates."""

import json

import pytest

from station.config.strict import ConfigError
from station.design.search import Candidates, SearchStopped, planned, search
from station.design.study import load_study
from station.recording.run_outcome import RecordingError

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
    """Evaluate candidates with a cost that is smallest at curvatures of 7 and 3."""
    for one in candidates:
        x, y = one.parameters
        keep({"parameters": [x, y], "cost": (x - 7.0) ** 2 + (y - 3.0) ** 2})


def until(count):
    """Return the engine `bowl`, interrupted by Ctrl-C after `count` candidates."""
    left = [count]

    def engine(candidates, keep):
        some = candidates[: left[0]]
        left[0] -= len(some)
        bowl(some, keep)

    return engine


def searched(study, folder, engine=bowl):
    with Candidates(folder, study) as candidates:
        return search(study, candidates, engine, lambda _: None)


def test_a_design_search_starts_with_the_given_robot_and_finds_the_minimum(study, tmp_path):
    lines = searched(study, tmp_path / "a")
    assert len(lines) == planned(study)
    assert lines[0]["parameters"] == [4.0, 4.0]
    best = min(lines, key=lambda line: line["cost"])
    assert best["parameters"] == pytest.approx([7.0, 3.0], abs=0.3)
    assert all(1.0 <= value <= 9.0 for line in lines for value in line["parameters"])


def test_a_design_search_stopped_twice_continues_to_the_same_result(study, tmp_path):
    whole = searched(study, tmp_path / "whole")
    for _ in range(2):
        with pytest.raises(SearchStopped, match="the same command continues"):
            searched(study, tmp_path / "parts", until(30))
    kept = (tmp_path / "parts" / "candidates.jsonl").read_bytes()
    assert kept.count(b"\n") == 1 + 60
    # The process was killed while it wrote a line.
    (tmp_path / "parts" / "candidates.jsonl").write_bytes(kept[:-20])
    evaluated = []

    def counted(candidates, keep):
        evaluated.extend(candidates)
        bowl(candidates, keep)

    assert searched(study, tmp_path / "parts", counted) == whole
    lines = (tmp_path / "parts" / "candidates.jsonl").read_text().splitlines()
    assert len({tuple(json.loads(line)["parameters"]) for line in lines[1:]}) == len(lines) - 1
    assert len(evaluated) == len(lines) - 1 - 59


def test_a_design_search_refuses_the_folder_of_another_search(study, tmp_path):
    searched(study, tmp_path / "a")
    (tmp_path / "bowl.toml").write_text(STUDY.replace("generations = 12", "generations = 13"))
    with pytest.raises(ConfigError, match=r"the folder has another search \(study differ\)"):
        searched(load_study(str(tmp_path / "bowl.toml")), tmp_path / "a")


def test_a_design_folder_is_locked_for_one_search_process_at_a_time(study, tmp_path):
    with Candidates(tmp_path, study), pytest.raises(RecordingError, match="another process searches in this folder"):
        Candidates(tmp_path, study)


def test_an_invalid_candidates_file_is_refused_and_not_overwritten(study, tmp_path):
    (tmp_path / "candidates.jsonl").write_text("notes\n")
    with pytest.raises(RecordingError, match="line 1: not JSON"):
        Candidates(tmp_path, study)
    assert (tmp_path / "candidates.jsonl").read_text() == "notes\n"
