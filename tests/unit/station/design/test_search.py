"""The search and its stored candidates."""

import json

import pytest

from station.design.search import candidates_file, planned, search
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


def bowl(candidate, _progress):
    """Evaluate a candidate with a cost that is smallest at curvatures of 7 and 3."""
    x, y = candidate.parameters
    return {"parameters": [x, y], "cost": (x - 7.0) ** 2 + (y - 3.0) ** 2}


def counted(evaluated, most=10_000):
    """Return the function `bowl`, interrupted by Ctrl-C after `most` candidates, which it adds to `evaluated`."""

    def work(candidate, progress):
        if len(evaluated) == most:
            raise KeyboardInterrupt
        evaluated.append(candidate)
        return bowl(candidate, progress)

    return work


def searched(study, folder, work=bowl):
    with candidates_file(folder, study) as stored:
        return search(study, stored, None, lambda _: None, work)


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
        with pytest.raises(KeyboardInterrupt):
            searched(study, tmp_path / "parts", counted([], 30))
    kept = (tmp_path / "parts" / "candidates.jsonl").read_bytes()
    assert kept.count(b"\n") == 1 + 60
    # The process was killed while it wrote a line.
    (tmp_path / "parts" / "candidates.jsonl").write_bytes(kept[:-20])
    evaluated = []
    assert searched(study, tmp_path / "parts", counted(evaluated)) == whole
    lines = (tmp_path / "parts" / "candidates.jsonl").read_text().splitlines()
    assert len({tuple(json.loads(line)["parameters"]) for line in lines[1:]}) == len(lines) - 1
    assert len(evaluated) == len(lines) - 1 - 59


def test_a_design_search_refuses_the_folder_of_another_search(study, tmp_path):
    searched(study, tmp_path / "a")
    (tmp_path / "bowl.toml").write_text(STUDY.replace("generations = 12", "generations = 13"))
    with pytest.raises(RecordingError, match=r"study\.search\.generations: 12 stored, 13 requested"):
        searched(load_study(str(tmp_path / "bowl.toml")), tmp_path / "a")
