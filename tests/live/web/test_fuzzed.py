"""Hundreds of invalid bodies cause no server error (5xx) and no motion."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tests.fuzz.rest import fuzz
from tests.harness.serving import Served
from tests.harness.waiting import NET

#: Values of query parameters that are empty, no number, out of every range, or too long.
ODD_VALUES = ("", "nan", "-inf", "1e999", "-1", "9" * 400, "x" * 5000, "\0", "\ud800".encode(errors="surrogatepass"))
#: Query parameters of the WebSockets, which the description of the REST interface does not contain.
SOCKETS = (("/api/telemetry", "rate"), ("/api/scene/tip", "rate"), ("/api/scene/tip", "client"))


def query_parameters(station: Served) -> Iterator[tuple[str, str, str]]:
    """Yield method, path and name of every query parameter of the REST interface."""
    for path, methods in station.rest.get("/api/openapi.json").json()["paths"].items():
        for method, described in methods.items():
            for parameter in described.get("parameters", ()):
                if parameter["in"] == "query":
                    yield method, path.replace("{run}", "latest").replace("{name}", "fig10"), parameter["name"]


def test_odd_query_parameters_of_rest_are_answered_or_refused_with_a_reason(station: Served) -> None:
    found = list(query_parameters(station))

    assert len(found) >= 8
    for method, path, name in found:
        for value in ODD_VALUES:
            answer = station.rest.request(method, f"{path}?{name}={quote(value)}")
            assert answer.status_code < 500, (path, name, value, answer.text)
            assert answer.is_success or not answer.content or answer.json()["error"], (path, name, value)


def refusal(url: str) -> tuple[int, str]:
    """Return status and reason of a refused WebSocket; (0, "") if it is accepted."""
    try:
        with connect(url, proxy=None):
            return 0, ""
    except InvalidStatus as refused:
        return refused.response.status_code, (refused.response.body or b"").decode()


@pytest.mark.parametrize(("path", "name"), SOCKETS)
def test_odd_query_parameters_of_websockets_are_accepted_or_refused_with_a_reason(
    station: Served, path: str, name: str
) -> None:
    for value in ODD_VALUES:
        status, reason = refusal(f"ws://127.0.0.1:{station.port}{path}?{name}={quote(value)}")
        # The name of a page may be any short text.
        assert (status == 422 and name in reason) or (name == "client" and not status), (value, status, reason)
    said = station.said.read_text(encoding="utf-8")
    assert "Traceback" not in said, said


def test_corrupted_rest_bodies_cause_no_server_error_and_no_motion(station: Served) -> None:
    fuzzed = fuzz(station, 150, seed=1)

    assert fuzzed.wrong == []
    assert sum(fuzzed.answers.values()) > 130
    assert fuzzed.answers[422] > 30


def test_valid_and_invalid_rest_requests_cause_no_server_error(station: Served, tmp_path: Path) -> None:
    command = [
        sys.executable, "-c", "from schemathesis.cli import schemathesis; schemathesis()",
        "run", f"{station.url}/api/openapi.json", "--checks", "not_a_server_error",
        "--phases", "examples,coverage,fuzzing", "--max-examples", "3", "--max-time", "10", "--seed", "1", "--no-color",
        "--request-timeout", str(NET),
        # the fuzzer sends no requests to the paths of viser and of the telemetry
        "--exclude-path-regex", "viser|telemetry",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=NET, check=False)

    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    station.ready()
