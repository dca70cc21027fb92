"""Run homing, a circle and calibrations on a practice bench as docs/student.md describes it, with its page open.

    python -m tests.tools.practice_bench [--times N] [--pages N] [--calibrate latency tracker] [--tcp]

The output is one JSON line per step: the state after the step, the cause of a HOLD or FAULT, and the computer's load.
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from tests.harness.chromium import PATIENCE, SIZE, chromium
from tests.harness.root import ROOT
from tests.harness.serving import Served, serving

CIRCLE = {"trajectory": {"kind": "circle", "radius": 0.01, "period": 20}, "duration": 40}
FAILED = ("HOLD", "FAULT", "STOPPED", "OFF")


@contextlib.contextmanager
def practice_lab(options: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the endpoints of `ctr-station lab`."""
    command = [sys.executable, "-c", "from web.cli import main; main()", "lab", *options]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, cwd=ROOT)
        try:
            assert process.stdout is not None
            yield json.loads(process.stdout.readline())
        finally:
            process.terminate()
            process.wait(30)
            errors.seek(0)
            sys.stderr.write(errors.read().decode())


def documented_tables() -> str:
    """Return the tables that docs/student.md adds to the station file of a practice bench."""
    page = (ROOT / "station" / "docs" / "student.md").read_text(encoding="utf-8")
    return "\n[clock]\n" + page.split("\n[clock]\n")[1].split("```")[0]


def station_file(endpoints: dict[str, Any]) -> str:
    """Return the text of the bench.toml that a student writes according to docs/student.md."""
    lines = [
        'robot = "paper"',
        "[devices.stages]",
        'driver = "zaber"',
        f'port = "{endpoints["zaber"]}"',
        "[devices.tracker]",
        'driver = "aurora"',
        f'port = "{endpoints["aurora"]}"',
        "mount = { position = [0.0, 0.0, -0.2], rotation_vector = [3.141593, 0.0, 0.0] }",
        "[devices.sensors]",
        'driver = "netft"',
    ]
    for box in endpoints["netft"]:
        rdt, page = urlsplit(box["rdt"]).port, urlsplit(box["page"]).port
        lines.append(f'tubes.{box["tube"]} = {{ host = "127.0.0.1", rdt_port = {rdt}, http_port = {page} }}')
    return "\n".join(lines) + "\n"


def step(station: Served, name: str, path: str, body: Any, ended: tuple[str, ...]) -> bool:
    """Request one step, wait for its end and print its result; return False after a HOLD or FAULT."""
    begun, load = time.monotonic(), []
    answer = station.post(path, body)
    status = station.status()
    if answer.status_code < 300:
        time.sleep(1.0)
        while (status := station.status())["state"] not in (*FAILED, *ended):
            if status["state"] == "CONNECTED":  # homing was aborted
                status["cause"] = str(station.rest.get("/api/log").json()[0])
                break
            load.append(os.getloadavg()[0])
            time.sleep(0.5)
    result = {
        "step": name,
        "answer": answer.status_code,
        "state": status["state"],
        "cause": status.get("cause", ""),
        "seconds": round(time.monotonic() - begun, 1),
        "load": round(max(load, default=os.getloadavg()[0]), 1),
    }
    if answer.status_code >= 300:
        result["refused"] = answer.text
    sys.stdout.write(json.dumps(result) + "\n")
    sys.stdout.flush()
    return answer.status_code < 300 and status["state"] in ended


def calibrate(station: Served, procedure: str) -> bool:
    """Run one calibration procedure with half the usual poses and print its result."""
    begun, load = time.monotonic(), []
    answer = station.post("/api/calibration/start", {"what": procedure, "effort": 0.5, "way_is_clear": True})
    course = answer.json().get("course")
    while course is not None and course["on"]:
        load.append(os.getloadavg()[0])
        time.sleep(0.5)
        course = station.rest.get("/api/calibration").json()["course"]
    status = station.status()
    result = {
        "step": f"calibrate {procedure}",
        "answer": answer.status_code,
        "outcome": answer.text if course is None else f"{course['stage']}: {course['message']}",
        "state": status["state"],
        "cause": status["cause"],
        "seconds": round(time.monotonic() - begun, 1),
        "load": round(max(load, default=os.getloadavg()[0]), 1),
    }
    sys.stdout.write(json.dumps(result) + "\n")
    sys.stdout.flush()
    return course is not None and bool(course["result"]) and status["state"] == "READY"


def practise(options: argparse.Namespace) -> bool:
    """Home, run a circle and calibrate; return whether no step ended in HOLD or FAULT."""
    lab_options = [] if options.tcp else ["--pty"]
    with contextlib.ExitStack() as owned:
        endpoints = owned.enter_context(practice_lab(lab_options))
        station = owned.enter_context(serving(settings=station_file(endpoints) + options.settings, rate=None))
        station.wait_for(lambda status: status["state"] == "CONNECTED")
        if options.pages:
            browser = owned.enter_context(chromium())
            for _ in range(options.pages):
                page = browser.new_page(viewport=SIZE)
                page.set_default_timeout(PATIENCE)
                page.goto(station.url)
            time.sleep(10.0)
        done = step(station, "home", "/api/home", {"way_is_clear": True}, ("READY",))
        done = done and step(station, "circle", "/api/start", CIRCLE, ("READY",))
        for procedure in options.calibrate:
            done = done and calibrate(station, procedure)
        return done


def main() -> None:
    """Practise as often as the option `--times` specifies."""
    parser = argparse.ArgumentParser(prog="python -m tests.tools.practice_bench")
    parser.add_argument("--times", type=int, default=1)
    parser.add_argument("--pages", type=int, default=1, help="browser pages that draw the station")
    parser.add_argument("--tcp", action="store_true", help="TCP lines instead of pseudo-terminals")
    parser.add_argument("--calibrate", nargs="*", default=["latency", "tracker"])
    parser.add_argument("--settings", default=documented_tables(), help="more lines of the station file")
    options = parser.parse_args()
    results = [practise(options) for _ in range(options.times)]
    sys.stdout.write(json.dumps({"completed": sum(results), "of": len(results)}) + "\n")


if __name__ == "__main__":
    main()
