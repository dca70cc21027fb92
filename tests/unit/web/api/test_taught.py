"""Motions made on the page: tried on the model, kept as experiment files, taken up again; on a station that is OFF."""

import pytest

from station.config.motions import WaypointsMotion
from station.config.strict import OWN_EXPERIMENTS
from station.experiments.experiment import load_experiment

POSE = {"outer_rotation": 0.0, "inner_rotation": 1.5707963267948966, "inner_translation": -0.1}
PLACES = [[0.0, 0.0, 0.0, 0.0], [5.0, 0.0, 0.005, 0.0], [10.0, 0.0, 0.005, 0.003]]
WAYPOINTS = {"kind": "waypoints", "points": PLACES}


@pytest.fixture
def own(monkeypatch, tmp_path):
    """A folder of one's own experiments, in use."""
    monkeypatch.setenv(OWN_EXPERIMENTS, str(tmp_path))
    return tmp_path


def tried(app, points, **more):
    answer = app.post("/api/try", json={"points": points, "start": POSE, **more})
    assert answer.status_code == 200, answer.text
    return answer.json()


def save(app, name, **more):
    return app.put(f"/api/experiments/{name}", json={"trajectory": WAYPOINTS, "duration": 12.0, "start": POSE} | more)


def test_places_that_the_tip_gets_to_are_possible_and_the_way_goes_through_them(app):
    found = tried(app, PLACES)
    assert (found["possible"], found["reason"], found["place"]) == (True, "", None)
    assert found["path"][0] == [0.0, 0.0, 0.0]
    assert found["path"][-1] == pytest.approx(PLACES[-1][1:])


def test_the_first_place_that_is_out_of_reach_is_named_with_the_limit_and_what_would_work(app):
    found = tried(app, [*PLACES, [25.0, 0.0, 0.12, 0.0], [40.0, 0.0, 0.0, 0.0]])
    assert (found["possible"], found["place"]) == (False, 3)
    assert "waypoints cannot be followed: at " in found["reason"]
    assert len(found["path"]) > 10  # drawn all the same


def test_a_place_that_is_gone_to_too_fast_is_named_with_the_bound(app):
    found = tried(app, [[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.02, 0.0]])
    assert (found["possible"], found["place"]) == (False, 1)
    assert "m/s^2 at 0 s is above 0.1 m/s^2; give the points around it more time" in found["reason"]
    assert found["path"] == []


def test_without_a_pose_it_is_tried_from_where_the_joints_are_if_that_is_known(app):
    answer = app.post("/api/try", json={"points": PLACES})
    assert answer.status_code == 409
    assert "where the joints are is not known" in answer.json()["error"]


def test_to_try_makes_nobody_operator_and_is_not_written_down(app):
    before = app.get("/api/log").json()
    tried(app, PLACES)
    assert app.get("/api/operator").json()["name"] is None
    assert app.get("/api/log").json() == before


def test_what_is_saved_is_an_experiment_like_any_other(app, own):
    answer = save(app, "three_places", title='By hand: "three" places')
    assert answer.status_code == 200, answer.text
    assert [path.name for path in own.iterdir()] == ["three_places.toml"]
    case = load_experiment("three_places").cases[0]
    assert case.file.title == 'By hand: "three" places'
    assert isinstance(case.file.trajectory, WaypointsMotion)
    assert case.file.trajectory.points == tuple(tuple(row) for row in PLACES)
    listed = {one["name"]: one for one in app.get("/api/experiments").json()}["three_places"]
    assert listed["error"] == listed["cases"][0]["refused"] == ""
    taken_up = app.get("/api/experiments/three_places/motion").json()
    assert taken_up["trajectory"]["points"] == PLACES
    assert taken_up["start"] == POSE
    app.delete("/api/operator")


def test_nothing_is_written_over_unless_that_is_asked_for(app, own):
    assert save(app, "mine").status_code == 200
    before = (own / "mine.toml").read_text()
    refused = save(app, "mine", duration=20.0)
    assert refused.status_code == 409
    assert "is there already; choose another name, or say replace" in refused.json()["error"]
    assert (own / "mine.toml").read_text() == before
    assert save(app, "mine", duration=20.0, replace=True).status_code == 200
    assert load_experiment("mine").cases[0].file.duration == 20.0
    app.delete("/api/operator")


@pytest.mark.parametrize(
    "name", ["..", "../up", "..%2Fup", "%2Fetc%2Fx", "a b", "-x", ".hidden", "a.toml", "x" * 61, "a%00b"]
)
def test_a_name_is_no_way_to_another_folder(app, own, name):
    assert save(app, name).status_code in (404, 405, 422)
    assert list(own.iterdir()) == []
    assert app.get("/api/operator").json()["name"] is None


def test_an_experiment_that_comes_with_the_station_is_not_hidden(app, own):
    refused = save(app, "fig10", replace=True)
    assert refused.status_code == 422
    assert "name = 'fig10' is that of an experiment that comes with the station" in refused.json()["error"]
    assert list(own.iterdir()) == []


def test_what_cannot_be_carried_out_is_not_saved(app, own):
    far = {"kind": "waypoints", "points": [[20.0, 0.0, 0.15, 0.0]], "max_speed": 0.1}
    refused = save(app, "far", trajectory=far)
    assert refused.status_code == 422
    assert "'far' is not saved: far.toml: case 'far': waypoints cannot be followed" in refused.json()["error"]
    assert list(own.iterdir()) == []


def test_without_a_folder_of_ones_own_there_is_one_beside_the_runs(app, monkeypatch, tmp_path):
    monkeypatch.setenv(OWN_EXPERIMENTS, "")
    answer = save(app, "beside")
    assert answer.status_code == 200, answer.text
    assert answer.json()["note"].endswith("experiments/beside.toml")
    assert "beside" in [one["name"] for one in app.get("/api/experiments").json()]
    app.delete("/api/operator")
