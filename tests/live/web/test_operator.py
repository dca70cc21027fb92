"""One operator, viewers, STOP from anybody, and the log of it all, on a station that really runs."""

import httpx
import msgspec
import pytest
import viser
from websockets.sync.client import connect

from tests.harness.serving import Served

ANNA, BEN = "anna-0123456789", "ben-0123456789"
HOLD = {"trajectory": {"kind": "hold"}, "duration": 20.0}


def person(station: Served, client: str, name: str) -> httpx.Client:
    return httpx.Client(base_url=station.url, headers={"x-ctr-client": client, "x-ctr-name": name}, timeout=10.0)


@pytest.fixture
def people(station: Served):
    station.rest.delete("/api/operator")
    with person(station, ANNA, "Anna") as anna, person(station, BEN, "J%C3%BCrgen") as ben:
        yield anna, ben
        for one in (anna, ben):
            one.delete("/api/operator")


def test_the_first_command_makes_operator_and_the_second_person_is_told_who(station: Served, people) -> None:
    anna, ben = people
    assert anna.get("/api/operator").json()["name"] is None
    assert anna.post("/api/start", json=HOLD).status_code == 202
    status = ben.get("/api/status").json()["operator"]
    assert (status["name"], status["you"], status["role"]) == ("Anna", False, "operator")
    for path, body in (
        ("/api/start", HOLD),
        ("/api/reset", None),
        ("/api/tare", None),
        ("/api/connect", None),
        ("/api/jog", {"space": "tip", "velocity": [0, 0, 0.001]}),
        ("/api/home", {"way_is_clear": True}),
        ("/api/operator", {}),
    ):
        refused = ben.post(path, json=body)
        assert refused.status_code == 409, path
        assert "'Anna' is operator; ask them, or take over on purpose" in refused.json()["error"]
    assert station.status()["state"] == "RUNNING"


def test_stop_is_taken_from_anybody(station: Served, people) -> None:
    anna, ben = people
    assert anna.post("/api/start", json=HOLD).status_code == 202
    assert ben.post("/api/stop").status_code == 200
    assert station.status()["state"] == "STOPPED"
    assert ben.post("/api/reset").status_code == 409
    assert anna.post("/api/reset").status_code == 200


def test_taking_over_is_on_purpose_and_seen_by_the_other(people) -> None:
    anna, ben = people
    assert anna.post("/api/operator", json={}).json()["you"]
    assert ben.post("/api/operator", json={}).status_code == 409
    taken = ben.post("/api/operator", json={"take_over": True}).json()
    assert (taken["name"], taken["you"]) == ("Jürgen", True)
    seen = anna.get("/api/status").json()["operator"]
    assert (seen["name"], seen["you"]) == ("Jürgen", False)
    assert anna.post("/api/tare", json={}).status_code == 409
    assert ben.delete("/api/operator").json()["name"] is None
    assert anna.post("/api/tare", json={}).status_code == 200


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/api/start", {"speed": 1.0}),
        ("/api/start", {"experiment": "fig99"}),
        ("/api/jog", {"space": "tip", "velocity": [9.0, 0.0, 0.0]}),
        ("/api/home", {"way_is_clear": False}),
        ("/api/pull", {}),
    ],
)
def test_a_command_that_makes_no_sense_makes_nobody_operator(people, path: str, body: dict) -> None:
    anna, ben = people
    assert anna.post(path, json=body).status_code == 422
    assert anna.get("/api/operator").json()["name"] is None
    # Nor does it cost the lease of somebody who has it.
    assert ben.post("/api/connect", json={}).status_code == 409  # not while READY: a command all the same
    assert ben.post(path, json=body).status_code == 422
    assert ben.get("/api/operator").json()["you"]


def test_a_name_is_one_line_and_not_too_long(people) -> None:
    anna, _ = people
    assert anna.post("/api/operator", json={"name": "A\nn\tna\x00"}).json()["name"] == "Anna"
    assert anna.post("/api/operator", json={"name": "A" * 41}).status_code == 422


def test_commands_and_refusals_are_in_the_log(people) -> None:
    anna, ben = people
    anna.post("/api/operator", json={})
    ben.post("/api/reset")
    anna.get("/api/status", headers={"origin": "http://evil.example"})
    hostile, refused, taken = anna.get("/api/log?count=3").json()
    assert taken["who"] == "Anna (operator)"
    assert taken["what"].startswith("POST /api/operator")
    assert taken["outcome"] == "200"
    assert refused["who"] == "Jürgen (operator)"
    assert "409 'Anna' is operator" in refused["outcome"]
    assert "evil.example" in hostile["outcome"]
    assert hostile["where"] == "127.0.0.1"


def test_a_held_jog_is_one_line_of_the_log(station: Served, people) -> None:
    anna, _ = people
    for _ in range(8):
        assert anna.post("/api/jog", json={"space": "joints", "velocity": [0.01, 0.0, 0.0]}).status_code == 200
    anna.post("/api/jog", json={"space": "joints", "velocity": [0.0, 0.0, 0.0]})
    jogs = [entry for entry in anna.get("/api/log?count=20").json() if "/api/jog" in entry["what"]]
    assert len(jogs) == 1
    station.wait_for(lambda s: s["state"] == "READY")


def test_forged_messages_to_the_scene_are_dropped_and_logged(station: Served, people) -> None:
    anna, _ = people
    address = f"ws://127.0.0.1:{station.port}/viser/as/{BEN}"
    with connect(address, subprotocols=[f"viser-v{viser.__version__}"], proxy=None, max_size=None) as socket:
        for message in (
            {"type": "GuiRemoveMessage", "uuid": "anything"},
            {"type": "ShareUrlRequest"},
            {"type": "TransformControlsUpdateMessage", "name": "/handle/target", "wxyz": [1, 0, 0, 0],
             "position": [0, 0, 9999.0], "owner": ""},
        ):  # fmt: skip
            socket.send(msgspec.msgpack.encode(message))
        socket.send("text")
        station.wait_for(lambda _: _drops(anna) >= {"no message that is known here", "no message of a scene"})
    assert any("not operator" in reason for reason in _drops(anna))


def _drops(client: httpx.Client) -> set[str]:
    entries = client.get("/api/log?count=20").json()
    return {entry["outcome"].removeprefix("dropped: ") for entry in entries if entry["what"] == "scene message"}
