"""The list of experiments, with invalid files; motions from the page are checked, saved and loaded again in OFF."""

import pytest

from station.config.motions import WaypointsMotion
from station.config.strict import EXPERIMENTS_VARIABLE, preset_names, use_experiments
from station.experiments.experiment import load_experiment, offered_experiment
from station.service.feasibility import incompatibility
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


def test_a_station_of_three_tubes_offers_every_experiment_that_its_robot_can_do():
    listed = experiments_out(load_station(None, {"robot": "three_tubes"}).bench(), check_motions=True)
    for one in listed:
        for case in one.cases:
            if one.name == "points":  # a singular pose
                assert "for robot 'balanced_pair'; this station has 'three_tubes'" in case.refused
            elif one.name == "keep_out":
                assert "the station does not know its region" in case.refused
            elif one.name != "follow":  # the lab has no target
                assert (one.name, case.name, case.refused, case.robot) == (one.name, case.name, "", "three_tubes")


@pytest.mark.parametrize("robot", preset_names("robots"))
def test_each_preset_robot_has_a_demo_and_does_not_warn_about_itself(robot):
    bench = load_station(None, {"robot": robot}).bench()
    (case,) = offered_experiment("demo", robot).cases
    assert incompatibility(case, bench) == ""
    assert bench.robot.working_pose == case.file.start
    assert not [text for text in bench.warnings if "snap" in text]


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


POSE = {"outer_rotation": 0.0, "inner_rotation": 1.5707963267948966, "inner_translation": -0.1}
PLACES = [[0.0, 0.0, 0.0, 0.0], [5.0, 0.0, 0.005, 0.0], [10.0, 0.0, 0.005, 0.003]]
WAYPOINTS = {"kind": "waypoints", "points": PLACES}


@pytest.fixture
def own(monkeypatch, tmp_path):
    """Return an empty folder, which the station uses for custom experiments."""
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, str(tmp_path))
    return tmp_path


def tried(app, points, **more):
    answer = app.post("/api/waypoints/check", json={"points": points, "start": POSE, **more})
    assert answer.status_code == 200, answer.text
    return answer.json()


def save(app, name, **more):
    return app.put(f"/api/experiments/{name}", json={"trajectory": WAYPOINTS, "duration": 12.0, "start": POSE} | more)


def test_reachable_waypoints_are_possible_and_the_path_goes_through_them(app):
    found = tried(app, PLACES)
    assert (found["possible"], found["reason"], found["place"]) == (True, "", None)
    assert found["path"][0] == [0.0, 0.0, 0.0]
    assert found["path"][-1] == pytest.approx(PLACES[-1][1:])


def test_the_first_unreachable_waypoint_is_named_with_the_limit_and_an_alternative(app):
    found = tried(app, [*PLACES, [25.0, 0.0, 0.12, 0.0], [40.0, 0.0, 0.0, 0.0]])
    assert (found["possible"], found["place"]) == (False, 3)
    assert "waypoints cannot be followed: at " in found["reason"]
    assert len(found["path"]) > 10  # the path is returned for drawing although it is unreachable


def test_a_waypoint_approached_too_fast_is_named_with_the_bound(app):
    found = tried(app, [[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.02, 0.0]])
    assert (found["possible"], found["place"]) == (False, 1)
    assert "m/s^2 at 0 s is above 0.1 m/s^2; give the points around it more time" in found["reason"]
    assert found["path"] == []


def test_a_waypoint_check_without_a_pose_starts_at_the_present_joints_if_known(app):
    answer = app.post("/api/waypoints/check", json={"points": PLACES})
    assert answer.status_code == 409
    assert "the present joints are unknown" in answer.json()["error"]


def test_a_waypoint_check_needs_no_operator_and_is_not_logged(app):
    before = app.get("/api/log").json()
    tried(app, PLACES)
    assert app.get("/api/operator").json()["name"] is None
    assert app.get("/api/log").json() == before


def test_a_saved_motion_is_an_experiment_like_any_other(app, own):
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


def test_an_experiment_is_overwritten_only_on_request(app, own):
    assert save(app, "mine").status_code == 200
    before = (own / "mine.toml").read_text()
    refused = save(app, "mine", duration=20.0)
    assert refused.status_code == 409
    assert "exists already; choose another name, or set replace" in refused.json()["error"]
    assert (own / "mine.toml").read_text() == before
    assert save(app, "mine", duration=20.0, replace=True).status_code == 200
    assert load_experiment("mine").cases[0].file.duration == 20.0
    app.delete("/api/operator")


@pytest.mark.parametrize(
    "name", ["..", "../up", "..%2Fup", "%2Fetc%2Fx", "a b", "-x", ".hidden", "a.toml", "x" * 61, "a%00b"]
)
def test_the_name_of_an_experiment_cannot_address_files_outside_its_folder(app, own, name):
    assert save(app, name).status_code in (404, 405, 422)
    assert list(own.iterdir()) == []
    assert app.get("/api/operator").json()["name"] is None


def test_a_saved_motion_cannot_hide_a_preset_experiment(app, own):
    refused = save(app, "fig10", replace=True)
    assert refused.status_code == 422
    assert "name = 'fig10' is used by a preset of the station" in refused.json()["error"]
    assert list(own.iterdir()) == []


def test_an_invalid_motion_is_not_saved(app, own):
    far = {"kind": "waypoints", "points": [[20.0, 0.0, 0.15, 0.0]], "max_speed": 0.1}
    refused = save(app, "far", trajectory=far)
    assert refused.status_code == 422
    assert "'far' is not saved: far.toml: case 'far': waypoints cannot be followed" in refused.json()["error"]
    assert list(own.iterdir()) == []


def test_experiments_are_saved_next_to_the_runs_without_a_configured_folder(app, monkeypatch, tmp_path):
    monkeypatch.setenv(EXPERIMENTS_VARIABLE, "")
    answer = save(app, "beside")
    assert answer.status_code == 200, answer.text
    assert answer.json()["note"].endswith("experiments/beside.toml")
    assert "beside" in [one["name"] for one in app.get("/api/experiments").json()]
    app.delete("/api/operator")


@pytest.mark.parametrize(
    "points",
    [
        [[1e308, 0, 0, 0]],
        [[1e300, 0, 0, 0]],
        [[5, 1e308, 0, 0], [10, -1e308, 0, 0]],
        [[5, 0, 0, 0.005], [1e5, 0, 0, 0]],
    ],
)
def test_waypoints_beyond_every_rig_are_refused_on_every_route(app, own, points):
    found = tried(app, points)
    assert not found["possible"]
    assert "is outside 0 ... 86400 s or +-10 m" in found["reason"]

    motion = {"kind": "waypoints", "points": points}
    for answer in (app.put("/api/trajectory", json=motion), save(app, "far", trajectory=motion)):
        assert answer.status_code == 422, answer.text
        assert "is outside 0 ... 86400 s or +-10 m" in answer.json()["error"]
    assert not list(own.iterdir())


def test_a_direction_at_a_time_beyond_every_rig_is_refused(app):
    motion = {"kind": "hold", "directions": [[0, 0, 0, 1], [1e300, 0, 0.1, 1]]}
    answer = app.put("/api/trajectory", json=motion)
    assert answer.status_code == 422
    assert "directions: time 1e+300 s is outside +-86400 s" in answer.json()["error"]


def test_a_cancelled_waypoint_check_ends_at_its_next_step():
    """The check counts its steps: at most one after the client has disconnected."""
    from core.errors import Cancelled
    from station.config.controllers import DEFAULT_CONTROLLER
    from station.config.motions import Places
    from station.config.robots import load_robot, start_pose
    from station.service.feasibility import check_waypoints

    robot, polls = load_robot("paper"), 0

    def cancelled():
        nonlocal polls
        polls += 1
        return polls > 3

    with pytest.raises(Cancelled):
        check_waypoints(
            Places(points=((60.0, 0.0, 0.0, 0.005),)),
            DEFAULT_CONTROLLER.controller(robot),
            start_pose(POSE, robot),
            cancelled,
        )
    assert polls == 4
