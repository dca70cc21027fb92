"""The REST interface of a live station."""

import itertools
import json
import math
import time
from pathlib import Path
from xml.etree import ElementTree

import httpx
import msgspec
import numpy as np
import viser
from websockets.sync.client import connect

from station.control.task import Phase
from station.recording.read import read_case
from tests.harness.serving import Served
from tests.harness.waiting import until

CONTROLLER = {"strategy": "dual_layer", "k1": 2.5, "k2": 2.5, "feedforward": True}


def test_rest_status_has_the_whole_state_of_the_station(station: Served) -> None:
    # Details of the devices are updated twice a second, so the status is polled.
    status = station.wait_for(
        lambda s: {(one["condition"], one["severity"]) for one in s["devices"].values()} == {("connected", 0)}
    )
    assert status["state"] == "READY"
    assert status["cause"] == ""
    assert set(status["joints"]) == {"outer_rotation", "inner_rotation", "inner_translation"}
    assert all(math.isfinite(x) for x in (*status["tip_measured"], *status["tip_estimated"], *status["force"]))
    assert set(status["devices"]) == {"stages", "tracker", "sensors"}
    assert (status["message"], status["next"]) == ("nothing moves", "choose a motion and press Start")
    assert "simulated" in status["lab"]
    assert status["loop"]["ticks"] > 0


def test_a_script_runs_a_trajectory_to_its_end(station: Served, tmp_path: Path) -> None:
    circle = {"kind": "circle", "radius": 0.005, "period": 4.0, "normal": [0, 0, 1]}
    answer = station.post("/api/start", {"trajectory": circle, "controller": CONTROLLER, "duration": 2.5})
    assert answer.status_code == 202, answer.text
    run = answer.json()["run_id"]
    status = station.wait_for(lambda s: s["state"] != "RUNNING" and not s["run"]["recording"])
    assert (status["state"], status["run"]["id"]) == ("READY", run)
    # The recording has every tip; a script that reads the status may miss a short motion.
    (tmp_path / "run.mcap").write_bytes(station.rest.get(f"/api/runs/{run}/recording").content)
    recording = read_case(tmp_path / "run.mcap")
    tips = 1e3 * recording.of("tip_true")[recording.of("phase")[:, 0] == Phase.MOVING]
    reached = np.linalg.norm(tips - tips[0], axis=1).max()
    assert abs(reached - 10.0) < 1.5


def test_a_contact_beyond_the_tubes_is_refused_with_their_end(station: Served) -> None:
    contact = {"kind": "contact", "magnitude": 0.3, "place": 0.9, "direction": [0.0, 1.0, 0.3]}
    beyond = station.post("/api/load", {"load": contact})
    assert beyond.status_code == 422
    assert "contact at 900 mm is outside 0 ... 20" in beyond.json()["error"]  # the largest position is about 203 mm


def test_a_load_that_changes_too_fast_is_accepted_with_a_warning_of_time_and_limit(station: Served) -> None:
    load = {"kind": "trapezoid", "magnitude": 0.2, "rise": 0.05, "start": 0.2}
    body = {"trajectory": {"kind": "hold"}, "controller": CONTROLLER, "duration": 2.0}
    answer = station.post("/api/start", body | {"load": load})
    assert answer.status_code == 202
    (warning,) = answer.json()["warnings"]
    assert "the joints cannot compensate load trapezoid: hold cannot be followed: at 0.2" in warning
    assert "because of speed of " in warning
    station.wait_for(lambda s: warning in s["warnings"])
    # The warning belongs to the run and disappears when the run ends.
    assert warning not in station.wait_for(lambda s: s["state"] == "READY")["warnings"]
    # Until the force of the removed load has decayed, the next run is refused, because its tare would hide a contact.
    slow = {"load": {**load, "rise": 60.0}}
    answers: list[str] = []
    until(lambda: answers.append(station.post("/api/start", body | slow).text) or '"error"' not in answers[-1], answers)
    assert json.loads(answers[-1])["warnings"] == []


def test_an_experiment_goes_to_its_start_pose_first(station: Served) -> None:
    assert station.post("/api/start", {"experiment": "fig10", "case": "feedforward"}).status_code == 202
    # The robot rests in the start pose before the motion, which leaves the pose.
    status = station.wait_for(lambda s: s["run"]["phase"] in ("settling", "moving"))
    joints = status["joints"]
    assert abs(joints["inner_translation"] + 0.100) < 1e-3
    assert abs(joints["inner_rotation"] - math.pi / 2) < 0.02
    assert "fig10" in status["run"]["title"]


def test_stop_is_always_accepted_and_latches_until_reset(station: Served) -> None:
    assert station.post("/api/stop").status_code == 200
    assert station.post("/api/stop").json() == {"state": "STOPPED", "note": "", "confirmed": True}
    refused = station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 1.0})
    assert refused.status_code == 409
    assert "STOPPED" in refused.json()["error"]
    assert station.post("/api/reset").json()["state"] == "READY"
    assert station.post("/api/reset").status_code == 409


def test_stop_brings_a_moving_robot_to_rest(station: Served) -> None:
    body = {"trajectory": {"kind": "sinusoid", "amplitude": 0.01, "frequency": 0.3}, "duration": 30.0}
    station.post("/api/start", body | {"controller": CONTROLLER})
    station.wait_for(lambda s: s["run"]["phase"] == "moving")
    begin = station.status()["joints"]
    station.wait_for(lambda s: s["joints"] != begin)
    station.post("/api/stop")
    seen: list[dict] = []
    station.wait_for(lambda s: seen.append(s["joints"]) or (len(seen) > 20 and seen[-1] == seen[-20]))
    assert station.status()["state"] == "STOPPED"


def test_marks_of_a_run_are_recorded_with_their_time_since_the_motions_start(station: Served) -> None:
    refused = station.post("/api/mark", {"text": "touched"})
    assert refused.status_code == 409
    assert "no run is being recorded" in refused.json()["error"]
    run = station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 100.0}).json()["run_id"]
    station.wait_for(lambda s: s["phase"] == "moving" and s["run"]["progress"] > 0.01)
    assert station.post("/api/mark", {"text": "touched the tip"}).status_code == 200
    assert station.post("/api/stop").status_code == 200
    station.wait_for(lambda s: s["state"] == "STOPPED" and not s["run"]["recording"])
    (curve,) = station.rest.get(f"/api/runs/{run}/curves").json().values()
    (mark,) = curve["marks"]
    assert mark["text"] == "touched the tip"
    assert 1.0 < mark["time"] <= 100.0
    station.ready()


def test_trajectory_and_controller_can_be_set_and_read_back(station: Served) -> None:
    circle = {"kind": "circle", "radius": 0.01, "period": 20.0, "normal": [1.0, 0.0, 0.0], "directions": []}
    assert station.rest.put("/api/trajectory", json=circle).json() == circle
    assert station.rest.get("/api/trajectory").json() == circle
    controller = station.rest.put("/api/controller", json={"strategy": "loaded_jacobian", "k1": 1.0}).json()
    assert (controller["strategy"], controller["k1"], controller["k2"]) == ("loaded_jacobian", 1.0, 2.5)
    assert station.rest.get("/api/controller").json() == controller
    refused = station.rest.put("/api/controller", json={"k1": 51.0})
    assert refused.status_code == 422
    assert station.rest.get("/api/controller").json() == controller
    station.rest.put("/api/controller", json=CONTROLLER)


def test_the_solve_request_returns_the_exact_tip_within_the_models_accuracy(station: Served) -> None:
    # The expected tip of the exact rod at this pose and load is from an independent solver.
    body = {"joints": {"outer_rotation": 0.0, "inner_rotation": math.pi / 2, "inner_translation": -0.075}}
    answer = station.post("/api/model/solve", body | {"force": [0.2, 0.0, 0.0]}).json()
    assert np.linalg.norm(1e3 * np.array(answer["tip"]) - [36.25495, -48.13712, 215.17980]) < 0.08
    assert answer["joints"] == ["outer_rotation", "inner_rotation", "inner_translation"]
    refused = station.post("/api/model/solve", {"joints": {"outer_rotation": 0.0}})
    assert refused.status_code == 422
    assert "inner_rotation" in refused.json()["error"]
    body["joints"]["inner_translation"] = 0.1
    assert "100 mm" in station.post("/api/model/solve", body).json()["error"]


def test_the_telemetry_stream_reports_skipped_rows(station: Served) -> None:
    with connect(f"ws://127.0.0.1:{station.port}/api/telemetry?rate=50", proxy=None) as socket:
        samples = [json.loads(socket.recv()) for _ in range(25)]
    times = [sample["time"] for sample in samples]
    assert all(later > earlier for earlier, later in itertools.pairwise(times))
    # Every tick is either sent, or counted as skipped, or counted as missed by the control loop.
    for earlier, later in itertools.pairwise(samples):
        assert round((later["time"] - earlier["time"]) / 0.002) == later["skipped"] + later["missed"] + 1
    assert sum(sample["skipped"] for sample in samples) > 0
    assert samples[0]["state"] == "READY"
    assert len(samples[0]["tip_measured"]) == len(samples[0]["force_filtered"]) == 3
    assert (samples[0]["phase"], samples[0]["estimates_frozen"], samples[0]["trouble"]) == (
        "none",
        0.0,
        [0.0, 0.0, 0.0],
    )
    assert {"late_us", "tick_us"} <= set(samples[0])


def test_unknown_rest_paths_are_not_found(station: Served) -> None:
    for path in ("/api/nothing", "/nowhere", "/static/nothing.js", "/api/experiments/nope/picture.svg"):
        assert station.rest.get(path).status_code == 404


def test_every_experiment_has_its_picture(station: Served) -> None:
    for experiment in station.rest.get("/api/experiments").json():
        answer = station.rest.get(f"/api/experiments/{experiment['name']}/picture.svg")
        assert answer.headers["content-type"].startswith("image/svg+xml")
        assert ElementTree.fromstring(answer.text).tag.endswith("svg")


def test_the_api_documentation_works_without_the_internet(station: Served) -> None:
    schema = station.rest.get("/api/openapi.json").json()
    assert {"/api/status", "/api/start", "/api/stop", "/api/model/solve"} <= set(schema["paths"])
    page = station.rest.get("/api/docs").text
    assert "https://" not in page
    script = page.split('<script src="')[1].split('"')[0]
    assert httpx.get(station.url + script).status_code == 200


def test_forged_messages_to_the_scene_are_dropped_and_logged(station: Served) -> None:
    def drops() -> set[str]:
        entries = station.rest.get("/api/log?count=20").json()
        return {entry["outcome"].removeprefix("dropped: ") for entry in entries if entry["what"] == "scene message"}

    address = f"ws://127.0.0.1:{station.port}/viser/as/somebody-0123456789"
    with connect(address, subprotocols=[f"viser-v{viser.__version__}"], proxy=None, max_size=None) as socket:
        for message in (
            {"type": "GuiRemoveMessage", "uuid": "anything"},
            {"type": "ShareUrlRequest"},
            {"type": "TransformControlsUpdateMessage", "name": "/handle/target", "wxyz": [1, 0, 0, 0],
             "position": [0, 0, 9999.0], "owner": ""},
        ):  # fmt: skip
            socket.send(msgspec.msgpack.encode(message))
        socket.send("text")
        station.wait_for(lambda _: drops() >= {"an unknown or invalid message", "not a message of the scene"})
        station.wait_for(lambda _: any("not operator" in reason for reason in drops()))


def test_reload_of_the_scene_does_not_transfer_its_program_again(station: Served) -> None:
    first = station.rest.get("/viser/")
    again = station.rest.get("/viser/", headers={"if-none-match": first.headers["etag"]})
    assert (first.status_code, again.status_code, again.content) == (200, 304, b"")
    assert len(first.content) > 100_000


def test_a_run_continues_without_its_operator(station: Served) -> None:
    operator = {"x-ctr-client": "the-operators-page"}
    run = {"trajectory": {"kind": "circle", "radius": 0.005, "period": 8.0}, "duration": 60.0}
    assert station.rest.post("/api/start", json=run, headers=operator).status_code == 202
    station.wait_for(lambda status: status["phase"] == "moving")
    # A page sends this request when it is closed; without it the lease expires later.
    assert station.rest.delete("/api/operator", headers=operator).status_code == 200
    # The operator watchdog polls a few times a second, so it has noticed the loss by then.
    time.sleep(2.0)
    assert station.status()["state"] == "RUNNING"


def test_a_killed_control_process_is_a_fault_at_once_and_a_reset_starts_a_new_one(station: Served) -> None:
    killed = station.control_process()
    killed.kill()
    status = station.wait_for(lambda s: s["state"] == "FAULT" and s["cause"])
    assert "signal 9" in status["cause"]
    station.wait_for(lambda s: s["stale"])
    stopped = station.post("/api/stop")  # accepted with a message, although no control process can execute it
    assert stopped.status_code in (200, 202)
    assert stopped.json()["state"] == "FAULT"
    assert station.post("/api/start", {"trajectory": {"kind": "hold"}}).status_code == 409
    assert station.post("/api/reset").json()["state"] == "READY"
    assert station.control_process().pid != killed.pid
    assert station.post("/api/start", {"trajectory": {"kind": "hold"}, "duration": 0.5}).status_code == 202
    station.wait_for(lambda s: s["state"] == "READY" and s["run"]["id"] != "")


def test_forwarding_headers_of_a_client_are_ignored(station: Served) -> None:
    headers = {"x-forwarded-for": "192.0.2.1", "x-forwarded-proto": "https", "forwarded": "for=192.0.2.1"}
    assert station.rest.get("/api/status", headers={**headers, "host": "evil.example"}).status_code == 403
    assert station.rest.get("/api/log?count=1").json()[0]["where"] == "127.0.0.1"
