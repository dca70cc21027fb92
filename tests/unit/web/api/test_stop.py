"""STOP over its socket: every message but a check is a STOP, and a viewer without the lease may send it."""

from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient, WebSocketTestSession

from station.control.commands import Command
from station.service.supervisor import Supervisor
from tests.harness.web_app import web_app
from web.access.identity import Tokens
from web.api.stop import LOGGED, PRESS_HEADER

PATH = "/api/stop/socket"


def connected(client: TestClient, **headers: str) -> WebSocketTestSession:
    host = {"host": client.base_url.netloc.decode()}  # the test client sends its own name otherwise
    return client.websocket_connect(PATH, headers=host | headers)


@pytest.mark.parametrize("text", ['{"press": 3}', "", "{", "[]", '"check"', '{"client": 1, "name": [], "press": "x"}'])
def test_every_message_but_a_check_is_a_stop(app: TestClient, text: str) -> None:
    with connected(app) as socket:
        socket.send_text("check")
        assert socket.receive_json() == {}
        socket.send_text(text)
        answer = socket.receive_json()
        assert answer.pop("press") in ("", "x")
        assert answer == app.post("/api/stop").json()


def test_copies_of_a_press_over_both_connections_are_one_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    executed: list[str] = []
    send = Supervisor.send

    def counted(self: Supervisor, command: Command, *more: Any) -> Any:
        executed.append(command.name)
        return send(self, command, *more)

    monkeypatch.setattr(Supervisor, "send", counted)
    with web_app(tmp_path) as client, connected(client) as socket:
        for press in ("a-first-press", "a-second-press"):
            answers: list[Any] = []
            for _ in range(2):
                socket.send_json({"press": press})
                answers.append(socket.receive_json())
                answers.append(client.post("/api/stop", headers={PRESS_HEADER: press}).json() | {"press": press})
            assert answers == 4 * [answers[0]]
        client.post("/api/stop")
        client.post("/api/stop", headers={PRESS_HEADER: "short"})  # no valid identity of a press

    assert answers[0]["confirmed"]
    assert executed == 4 * ["stop"]


def test_log_names_the_sender_and_a_flood_of_stops_leaves_few_lines(tmp_path: Path) -> None:
    with web_app(tmp_path) as client, connected(client) as socket:
        socket.send_json({"press": "a-press-of-anna", "client": "a-page-of-anna", "name": "Anna"})
        assert socket.receive_json()["press"] == "a-press-of-anna"
        for number in range(200):
            socket.send_json({"client": "a-page-of-ben", "name": f"Ben {number}"})
            socket.receive_json()
        entries = [entry for entry in client.get("/api/log?count=500").json() if entry["what"] == LOGGED]
    assert (entries[-1]["who"], entries[-1]["outcome"]) == ("Anna (operator)", "200")
    assert len(entries) <= 5


def test_bytes_end_only_the_socket_of_their_client(app: TestClient) -> None:
    with connected(app) as other, connected(app) as socket:
        socket.send_bytes(b"\x00")
        other.send_text("check")
        assert other.receive_json() == {}


def test_check_is_refused_like_stop_and_a_viewer_may_send_both(tmp_path: Path) -> None:
    tokens = Tokens("the-operators-token", "the-viewers-token")
    with web_app(tmp_path, "10.1.2.3", tokens) as client:
        for token, check, stop in (("the-viewers-token", 200, 202), ("an old token", 401, 401)):
            headers = {"authorization": f"Bearer {token}"}
            assert client.post("/api/stop/check", headers=headers).status_code == check
            assert client.post("/api/stop", headers=headers).status_code == stop
        with connected(client, authorization="Bearer the-viewers-token") as socket:
            socket.send_text("check")
            assert socket.receive_json() == {}
