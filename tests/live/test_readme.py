"""README's scripts and curl lines, unchanged except for the address, on a station that needs homing."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.harness.root import ROOT
from tests.harness.serving import Served, serving
from tests.harness.waiting import NET

README = (ROOT / "README.md").read_text(encoding="utf-8")
#: The stages start near their home position, so that homing is short.
NEAR_HOME = "park = { outer_rotation = 0.05, inner_rotation = 0.05, inner_translation = -0.128 }\n"


@pytest.fixture(scope="module")
def near_home():
    with serving(settings=NEAR_HOME, rate=1.0) as served:
        yield served


def block(language: str, content: str) -> str:
    """Return README's only code block of a language with this content."""
    (found,) = [text for text in re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL) if content in text]
    return found


def call(*command: str, folder: Path) -> str:
    environment = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=NET, cwd=folder, env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_readme_script_homes_runs_its_circle_and_downloads_it(near_home: Served, tmp_path: Path):
    script = block("python", "station.home()").replace("Station()", f"Station({near_home.url!r})")
    call(sys.executable, "-c", script, folder=tmp_path)
    assert (tmp_path / "circle.mcap").read_bytes().startswith(b"\x89MCAP0\r\n")
    status = near_home.status()
    assert status["state"] == "READY"
    assert status["run"]["title"].startswith("circle, radius ")
    # the circle started from the working pose
    assert status["joints"]["inner_rotation"] == pytest.approx(1.57, abs=0.1)


def test_readme_script_ends_with_one_sentence_while_a_page_is_operator(near_home: Served, tmp_path: Path):
    script = block("python", "station.home()").replace("Station()", f"Station({near_home.url!r})")
    assert near_home.post("/api/operator", {"name": "Anna", "take_over": True}).status_code == 200
    environment = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"}
    with subprocess.Popen(
        [sys.executable, "-c", script], stderr=subprocess.PIPE, text=True, cwd=tmp_path, env=environment
    ) as done:
        # Each request of the page renews its lease, which expires after 10 s; a script may take longer to start.
        near_home.wait_for(lambda _: done.poll() is not None)
        assert done.stderr is not None
        error = done.stderr.read()
    near_home.rest.delete("/api/operator")
    assert done.returncode == 1
    assert error.count("\n") == 1
    assert error.startswith("'Anna' is operator, so this script may not send commands: press Release")


def test_readme_script_streams_setpoints(near_home: Served, tmp_path: Path):
    near_home.wait_for(lambda status: status["state"] == "READY")
    script = block("python", "station.setpoints()").replace("Station()", f"Station({near_home.url!r})")
    short = script.replace("setpoints()", "setpoints(silence=2.0, end=60.0)").replace("duration=20.0", "duration=3.0")
    output = call(sys.executable, "-c", short, folder=tmp_path).splitlines()
    assert "mm off" in output[-1]
    assert near_home.wait_for(lambda status: status["state"] == "READY")["run"]["title"] == "streamed setpoints"


def test_readme_curl_lines_start_a_circle_print_the_state_and_stop_it(near_home: Served, tmp_path: Path):
    near_home.wait_for(lambda status: status["state"] == "READY")
    lines = block("sh", "curl -X POST").replace("localhost:8000", f"localhost:{near_home.port}")
    output = call("bash", "-ec", lines.replace("curl ", "curl -sS -w '\\n' "), folder=tmp_path)
    started, status, stopped = (json.loads(line) for line in output.splitlines())
    assert started["run_id"] == status["run"]["id"]
    assert status["state"] == "RUNNING"
    assert stopped == {"state": "STOPPED", "note": "", "confirmed": True}
