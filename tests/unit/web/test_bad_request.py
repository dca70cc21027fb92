"""A malformed or oversized REST body, NaN or an unknown field is refused (4xx) with field and reason."""

import json
import re
from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient, WebSocketDenialResponse

from core.control.trajectories import MAX_WAYPOINTS
from web.access.gate import MAX_BODY_BYTES, MAX_MOTION_BYTES

JSON = {"content-type": "application/json"}


@pytest.mark.parametrize(
    ("path", "body", "named"),
    [
        ("/api/start", '{"duration": NaN}', "duration"),
        ("/api/start", '{"trajectory": {"kind": "circle", "radius": -Infinity, "period": 10}}', "radius"),
        ("/api/start", '{"speed": 1}', "unknown field 'speed'"),
        ("/api/start", '{"duration": 10', "not JSON"),
        ("/api/start", "\u00ff\u0000", "not JSON"),
        ("/api/jog", '{"space": "tip", "velocity": [NaN, 0, 0]}', "velocity"),
        ("/api/jog", '{"space": "tip", "velocity": [0.5, 0, 0]}', "x = 0.5 m/s is outside +-0.01 m/s"),
        ("/api/jog", '{"space": "joints", "velocity": [0, 0]}', "3 velocities"),
        ("/api/home", "{}", "way_is_clear"),
        ("/api/home", '{"way_is_clear": false}', "way_is_clear"),
        ("/api/load", '{"load": {"kind": "constant", "magnitude": NaN}}', "magnitude"),
        ("/api/faults", '{"faults": [{"kind": "melt", "device": "tracker"}]}', "kind"),
        ("/api/model/solve", '{"joints": {"outer_rotation": NaN}}', "outer_rotation"),
        ("/api/operator", '{"name": 7}', "name"),
        ("/api/start", '{"duration": 1e999}', "duration"),
        ("/api/start", '{"duration": -1}', "duration"),
        ("/api/start", '{"duration": "10"}', "duration"),
        ("/api/start", '{"experiment": "nope"}', "nope"),
        ("/api/start", '{"experiment": "fig10", "duration": 5}', "give either an experiment"),
        ("/api/start", '{"case": "paper"}', "experiment"),
        ("/api/start", '{"trajectory": {"kind": "spiral"}}', "spiral"),
        ("/api/start", '{"trajectory": {"kind": "circle", "radius": 5, "period": 10}}', "radius"),
        (
            "/api/start",
            '{"trajectory": {"kind": "sinusoid", "direction": [0, 0, 0], "amplitude": 0.01, "frequency": 1}}',
            "direction",
        ),
        ("/api/start", '{"controller": {"strategy": "magic"}}', "magic"),
        ("/api/start", '{"controller": {"k1": 1000}}', "K1"),
        ("/api/start", '{"load": {"kind": "constant", "magnitude": -1}}', "magnitude"),
        ("/api/start", '{"load": {"kind": "constant", "magnitude": 20.1}}', "magnitude"),
        ("/api/start", "[]", "body"),
        ("/api/start", "[" * 60_000, "body"),
        ("/api/start", '"\\ud800"', "body"),
    ],
)
def test_an_invalid_rest_body_is_refused_with_field_and_reason(
    app: TestClient, path: str, body: str, named: str
) -> None:
    answer = app.post(path, content=body.encode(), headers=JSON)

    assert 400 <= answer.status_code < 500
    assert named in answer.json()["error"]
    assert app.get("/api/operator").json()["name"] is None  # the refused request made no client operator


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (
            '{"trajectory": {"kind": "waypoints", "points": [[5, 0, 0, "a"]]}}',
            "trajectory.points, row 1, number 4 = 'a': ",
        ),
        ('{"load": {"kind": "ramps", "times": [0, 1], "magnitudes": [0, -21]}}', "load.magnitudes, number 2 = -21: "),
        (
            '{"trajectory": {"kind": "circle", "radios": 0.1}}',
            "unknown field 'trajectory.radios'; 'trajectory.radius' is missing; 'trajectory.period' is missing",
        ),
    ],
)
def test_a_refusal_names_location_and_cause_without_the_parsers_terms(app: TestClient, body: str, told: str) -> None:
    assert app.post("/api/start", content=body.encode(), headers=JSON).json()["error"].startswith(told)


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/api/start", '{"experiment": "HALF"}'),
        ("POST", "/api/start", '{"experiment": "fig10", "case": "HALF"}'),
        ("POST", "/api/start", '{"HALF": 1}'),
        ("POST", "/api/start", '{"trajectory": {"kind": "HALF"}}'),
        ("POST", "/api/model/solve", '{"joints": {"HALF": 0}}'),
        ("POST", "/api/calibration/exchange", '{"robot": "HALF"}'),
        ("POST", "/api/calibration/exchange", '{"file": "name = \\"HALF\\""}'),
        ("POST", "/api/calibration/start", '{"what": "HALF", "way_is_clear": true}'),
        ("POST", "/api/operator", '{"name": "HALF"}'),
        ("POST", "/api/faults", '{"faults": [{"kind": "mute", "device": "HALF"}]}'),
        ("PUT", "/api/runs/latest/notes", '{"notes": "HALF"}'),
        ("PUT", "/api/scene", '{"HALF": true}'),
    ],
)
# a half as an escape sequence (twice) and as raw bytes
@pytest.mark.parametrize("half", [b"\\ud800", b"a\\uDfFf", b"\xed\xa0\x80"])
def test_half_of_a_surrogate_pair_in_a_body_is_refused(
    app: TestClient, method: str, path: str, body: str, half: bytes
) -> None:
    answer = app.request(method, path, content=body.encode().replace(b"HALF", half), headers=JSON)

    assert answer.status_code == 422
    assert "half of a surrogate pair" in answer.json()["error"]
    assert app.get("/api/operator").json()["name"] is None


def test_a_complete_surrogate_pair_in_a_body_is_accepted(app: TestClient) -> None:
    answer = app.post("/api/operator", content=b'{"name": "\\ud83d\\ude00"}', headers=JSON)
    assert answer.json()["name"] == "\U0001f600"
    app.delete("/api/operator")


@pytest.mark.parametrize(
    ("path", "most"), [("/api/start", MAX_MOTION_BYTES), ("/api/stop", MAX_BODY_BYTES), ("/api/jog", MAX_BODY_BYTES)]
)
def test_an_oversized_body_is_not_read_to_its_end(app: TestClient, path: str, most: int) -> None:
    huge = b'{"duration": 1' + b" " * most + b"}"
    answer = app.post(path, content=huge, headers=JSON)

    assert answer.status_code == 413
    assert f"at most {most} " in answer.json()["error"]
    assert app.get("/api/operator").json()["name"] is None  # the refused request made no client operator


def test_an_oversized_body_without_a_length_is_not_read_to_its_end(app: TestClient) -> None:
    def chunks() -> Iterator[bytes]:
        for _ in range(50):
            yield b" " * 4096

    answer = app.post("/api/jog", content=chunks(), headers=JSON)
    assert answer.status_code == 413
    assert "65536" in answer.json()["error"]


def test_every_request_with_a_motion_may_have_the_largest_table_of_waypoints(app: TestClient) -> None:
    api = app.get("/api/openapi.json").json()

    def schemas(part: object, known: frozenset[str] = frozenset()) -> frozenset[str]:
        """Return the names of all schemas to which a part of the description refers."""
        for name in set(re.findall(r"#/components/schemas/([\w-]+)", json.dumps(part))) - known:
            known = schemas(api["components"]["schemas"][name], known | {name})
        return known

    bodies = [
        (method, path)
        for path, methods in api["paths"].items()
        for method, call in methods.items()
        if schemas(call.get("requestBody")) & {"WaypointsMotion", "WaypointCheckIn"}
    ]
    assert len(bodies) == 5
    row = [-1.2345678901234567e-101] * 4  # as long as a row can be
    body = json.dumps({"points": [row] * MAX_WAYPOINTS}).encode()
    for method, path in bodies:
        answer = app.request(method, path.replace("{name}", "mine"), content=body, headers=JSON)
        assert answer.status_code != 413, path


def test_waypoints_beyond_the_limit_are_refused_with_their_number_and_the_limit(app: TestClient) -> None:
    points = [[0.5 * (number + 1), 0.0, 0.0, 0.0] for number in range(MAX_WAYPOINTS + 1)]
    for path, body in (
        ("/api/waypoints/check", {"points": points}),
        ("/api/start", {"trajectory": {"kind": "waypoints", "points": points}}),
    ):
        answer = app.post(path, json=body)
        assert answer.status_code == 422
        assert answer.json()["error"].endswith("at most 10000 items after validation, not 10001")


@pytest.mark.parametrize("path", ["/api/telemetry?rate=200", "/api/telemetry?rate=fast"])
def test_a_websocket_with_an_invalid_parameter_is_refused_with_its_name_and_value(app: TestClient, path: str) -> None:
    headers = {"host": app.base_url.netloc.decode()}
    with pytest.raises(WebSocketDenialResponse) as refused, app.websocket_connect(path, headers=headers):
        pass
    assert refused.value.status_code == 422
    assert refused.value.json()["error"].startswith("rate = ")
