"""The list of experiments; an invalid file is listed with its error and hides no other."""

import pytest

from station.config.strict import EXPERIMENTS_VARIABLE, preset_names, use_experiments
from station.service.station_file import load_station
from web.api.experiments import experiments_out


@pytest.fixture
def folder(monkeypatch, tmp_path):
    """Return an empty folder, which the station uses for custom experiments."""
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, "")  # pytest restores the variable after the test
    use_experiments(tmp_path)
    return tmp_path


def test_an_invalid_experiment_file_is_listed_with_its_error_and_hides_no_other(app, folder, short):
    (folder / "notes.toml").write_text('say = "milk"\n', encoding="utf-8")
    (folder / "torn.toml").write_text("[[[", encoding="utf-8")
    (folder / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (folder / "folder.toml").mkdir()
    (folder / "still.toml").write_text(short, encoding="utf-8")
    answer = app.get("/api/experiments")
    assert answer.status_code == 200
    listed = {one["name"]: one for one in answer.json()}
    assert set(listed) == set(preset_names("experiments"))
    for name in ("notes", "torn", "binary", "folder"):
        assert listed[name]["cases"] == []
        assert f"{name}.toml: " in listed[name]["error"]
    for name in ("demo", "fig8", "still"):
        assert listed[name]["error"] == ""
        assert listed[name]["cases"][0]["refused"] == ""


def test_a_broken_experiment_file_has_no_picture_and_the_error_names_the_file(app, folder):
    (folder / "notes.toml").write_text('say = "milk"\n', encoding="utf-8")
    drawn = app.get("/api/experiments/notes/picture.svg")
    assert drawn.status_code == 422
    assert "notes.toml" in drawn.json()["error"]


def test_a_station_of_three_tubes_lists_the_papers_experiments_as_refused():
    listed = experiments_out(load_station(None, {"robot": "three_tubes"}).bench())
    for one in listed:
        for case in one.cases:
            other = "balanced_pair" if one.name == "points" else "paper"
            assert f"for robot '{other}'; this station has 'three_tubes'" in case.refused


def test_each_case_of_an_experiment_has_a_description_and_facts_with_numbers(app):
    listed = {one["name"]: one for one in app.get("/api/experiments").json()}
    first = listed["step_response"]["cases"][0]
    assert (first["name"], first["words"]) == ("k1_x", "k = 1 1/s, 1 mm along x")
    assert {"what": "motion", "text": "step: offset 1, 0, 0 mm, stay 6 s"} in first["facts"]
    assert "regulation, ramp 10s" in [case["words"] for case in listed["load_rate"]["cases"]]
    distorted = listed["fig8"]["cases"][-1]
    assert distorted["warnings"][0].startswith("written for lab 'distorted', runs on this station instead")


def test_each_case_of_an_experiment_has_its_picture(app):
    def drawn(query: str) -> str:
        answer = app.get(f"/api/experiments/fig8/picture.svg{query}")
        assert answer.status_code == 200
        return answer.text

    assert drawn("") == drawn("?case=regulation")
    assert drawn("?case=lift_and_drop") != drawn("")
    assert app.get("/api/experiments/fig8/picture.svg?case=nope").status_code == 404
