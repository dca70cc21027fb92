"""Rules for operator, viewers and audit log, independent of the station's state."""

from typing import Any

import httpx
import pytest
from starlette.testclient import TestClient

HOLD = {"trajectory": {"kind": "hold"}, "duration": 20.0}


class Person:
    """A client with a name."""

    def __init__(self, app: TestClient, client: str, name: str) -> None:
        self._app, self.headers = app, {"x-ctr-client": f"{client}-0123456789", "x-ctr-name": name}

    def get(self, path: str, **headers: str) -> httpx.Response:
        return self._app.get(path, headers=self.headers | headers)

    def post(self, path: str, body: Any = None) -> httpx.Response:
        return self._app.post(path, json={} if body is None else body, headers=self.headers)

    def leave(self) -> httpx.Response:
        return self._app.delete("/api/operator", headers=self.headers)


@pytest.fixture
def people(app: TestClient):
    anna, ben = Person(app, "anna", "Anna"), Person(app, "ben", "J%C3%BCrgen")
    yield anna, ben
    for one in (anna, ben):
        one.leave()


def test_the_first_command_makes_its_sender_operator_and_a_second_client_gets_the_name(people) -> None:
    anna, ben = people
    assert anna.get("/api/operator").json()["name"] is None
    # The station's state forbids the start, but it is a valid command, so its sender becomes operator.
    assert "OFF" in anna.post("/api/start", HOLD).json()["error"]
    status = ben.get("/api/status").json()["operator"]
    assert (status["name"], status["you"], status["role"]) == ("Anna", False, "operator")
    for path, body in (
        ("/api/start", HOLD),
        ("/api/reset", None),
        ("/api/tare", None),
        ("/api/connect", None),
        ("/api/jog", {"space": "tip", "velocity": [0, 0, 0.001]}),
        ("/api/home", {"way_is_clear": True}),
        ("/api/goto", {}),
        ("/api/operator", {}),
        ("/api/calibration/start", {"what": "axes", "way_is_clear": True}),
    ):
        refused = ben.post(path, body)
        assert refused.status_code == 409, path
        assert "'Anna' is operator; ask them, or take over" in refused.json()["error"]


def test_stop_is_accepted_from_any_client(people) -> None:
    anna, ben = people
    anna.post("/api/operator")
    stopped = ben.post("/api/stop")
    assert stopped.status_code == 202
    note = "there is no control process and nothing moves"
    assert stopped.json() == {"state": "OFF", "note": note, "confirmed": True}
    assert anna.get("/api/operator").json()["you"]


def test_a_take_over_must_be_explicit_and_is_visible_to_the_other_client(people) -> None:
    anna, ben = people
    assert anna.post("/api/operator").json()["you"]
    assert ben.post("/api/operator").status_code == 409
    taken = ben.post("/api/operator", {"take_over": True}).json()
    assert (taken["name"], taken["you"]) == ("Jürgen", True)
    seen = anna.get("/api/status").json()["operator"]
    assert (seen["name"], seen["you"]) == ("Jürgen", False)
    assert "'Jürgen' is operator" in anna.post("/api/tare").json()["error"]
    assert ben.leave().json()["name"] is None
    assert "is operator" not in anna.post("/api/tare").json()["error"]


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/api/start", {"speed": 1.0}),
        ("/api/start", {"experiment": "fig99"}),
        ("/api/jog", {"space": "tip", "velocity": [9.0, 0.0, 0.0]}),
        ("/api/home", {"way_is_clear": False}),
        ("/api/load", {}),
    ],
)
def test_an_invalid_command_does_not_make_its_sender_operator(people, path: str, body: dict) -> None:
    anna, ben = people
    assert anna.post(path, body).status_code == 422
    assert anna.get("/api/operator").json()["name"] is None
    # An invalid command does not end the lease of a client that is operator.
    assert ben.post("/api/tare").status_code == 409
    assert ben.post(path, body).status_code == 422
    assert ben.get("/api/operator").json()["you"]


def test_a_clients_name_is_one_line_of_limited_length(people) -> None:
    anna, _ = people
    assert anna.post("/api/operator", {"name": "A\nn\tna\x00"}).json()["name"] == "Anna"
    assert anna.post("/api/operator", {"name": "A" * 41}).status_code == 422


def test_the_operators_name_is_unchanged_by_later_commands(people) -> None:
    anna, _ = people
    anna.post("/api/operator", {"name": "Anna at the bench"})
    anna.post("/api/tare")
    assert anna.get("/api/operator").json()["name"] == "Anna at the bench"


def test_commands_and_refusals_are_in_the_log(people) -> None:
    anna, ben = people
    anna.post("/api/operator")
    ben.post("/api/reset")
    anna.get("/api/status", origin="http://evil.example")
    hostile, refused, taken = anna.get("/api/log?count=3").json()
    assert taken["who"] == "Anna (operator)"
    assert taken["what"].startswith("POST /api/operator")
    assert taken["outcome"] == "200"
    assert refused["who"] == "Jürgen (operator)"
    assert "409 'Anna' is operator" in refused["outcome"]
    assert "evil.example" in hostile["outcome"]
    assert hostile["where"] == "127.0.0.1"
