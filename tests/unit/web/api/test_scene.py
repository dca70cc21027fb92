"""The scene over REST and its stream, on a station that is OFF."""

import json

import pytest
from starlette.testclient import TestClient

from station.config.robots import load_robot
from tests.harness.web_app import HOST, PORT
from web.scene.cameras import VIEWS
from web.scene.content import NOTHING


def test_the_legend_names_every_mark_every_tube_and_every_view(app: TestClient) -> None:
    legend = app.get("/api/scene/legend").json()
    assert legend["views"] == list(VIEWS)
    assert [tube["diameter"] for tube in legend["tubes"]] == [
        tube.outer_diameter for tube in load_robot("paper").robot().tubes
    ]
    names = [sign["name"] for sign in legend["signs"]]
    for word in ("desired", "measured", "estimated", "force", "reference"):
        # the close-up finds the colours of the scene's objects by these names
        assert any(name.startswith(word) for name in names)


def test_the_close_up_reports_that_there_is_no_telemetry_and_accepts_any_text(app: TestClient) -> None:
    with app.websocket_connect(f"ws://{HOST}:{PORT}/api/scene/tip?client=nobody-at-all&rate=30") as socket:
        assert socket.receive_json() == json.loads(json.dumps(NOTHING.to_json()))
        for text in ("Tip", "", "\x00", "x" * 5000):
            socket.send_text(text)
        assert socket.receive_json()["message"] == "no telemetry yet"


@pytest.mark.parametrize("position", [[1e308, 0.0, 0.0], [-1e308, 1e30, 1e300], [0.0, -1001.0, 0.0]])
def test_target_beyond_every_robot_is_refused(app: TestClient, position: list[float]) -> None:
    """Its drawing would overflow, and the terminal of the station would show a warning of numpy."""
    answer = app.put("/api/scene/target", json={"position": position})
    assert answer.status_code == 422
    assert "at most 1000 m" in answer.json()["error"]
    app.delete("/api/operator")
