"""Measure the time from a press of STOP to the stop bytes: `python -m tests.tools.stop_latency [PRESSES]`.

STOP is pressed on a real page in Chromium during a run, while five viewers watch. Each viewer is a separate process
that receives the scene, the telemetry and the status, as a page does. The station drives the devices of
`ctr-station lab` through a relay that records when the bytes of a stop pass. The latency is the time from the press, by
the browser's clock, to the last byte of the last stop message of the three axes.
"""

import contextlib
import json
import math
import multiprocessing
import os
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from multiprocessing.connection import Connection
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
import viser
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from station.benchmarks.loop import stolen_seconds
from station.control.realtime import request_fifo
from tests.harness.chromium import bare_page, chromium
from tests.harness.root import ROOT
from tests.harness.serving import serving

VIEWERS = 5
STOP = 23  #: number of the stop command in the stages' binary protocol
AXES = 3
#: Real-time priority of the simulated devices, if the system grants one; the control loop has a higher priority.
PRIORITY = 40
RUN = {"experiment": "fig10", "case": "feedforward"}


def relay(address: tuple[str, int], told: Connection) -> None:
    """Pass bytes between the station and the simulated line; send the port, then the times of stops [s] since 1970."""
    request_fifo(PRIORITY)
    with socket.create_server(("127.0.0.1", 0)) as server:
        told.send(server.getsockname()[1])
        while True:
            host = server.accept()[0]
            with closing(host), closing(socket.create_connection(address)) as line:
                for end in (host, line):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                _pass_on(host, line, told)


def _pass_on(host: socket.socket, line: socket.socket, told: Connection) -> None:
    pending = b""
    while True:
        for end in select.select([host, line], [], [])[0]:
            data = end.recv(4096)
            if not data:
                return
            (line if end is host else host).sendall(data)
            if end is host:
                pending += data
                while len(pending) >= 6:
                    if pending[1] == STOP:
                        told.send(time.time())
                    pending = pending[6:]


@contextmanager
def relayed(address: tuple[str, int]) -> Iterator[Connection]:
    ours, theirs = multiprocessing.get_context("spawn").Pipe()
    process = multiprocessing.get_context("spawn").Process(target=relay, args=(address, theirs), daemon=True)
    process.start()
    try:
        yield ours
    finally:
        process.terminate()
        process.join()


def heard(told: Connection) -> list[float]:
    """Return the times of the stops since the last call."""
    times = []
    while told.poll():
        times.append(told.recv())
    return times


@contextmanager
def lab() -> Iterator[dict[str, Any]]:
    process = subprocess.Popen([sys.executable, "-m", "station", "lab"], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert process.stdout is not None
        endpoints = json.loads(process.stdout.readline())
        # Real devices have their own processors, so the simulated devices get real-time priority.
        with contextlib.suppress(OSError, AttributeError):
            os.sched_setscheduler(process.pid, os.SCHED_FIFO, os.sched_param(PRIORITY))
        yield endpoints
    finally:
        process.terminate()
        process.wait()


def watch(port: int) -> None:
    """Run one viewer that keeps open every connection that a page has."""
    protocol: Any = f"viser-v{viser.__version__}"

    def drain(path: str, **more: Any) -> None:
        with (
            contextlib.suppress(OSError, WebSocketException),
            connect(f"ws://127.0.0.1:{port}{path}", proxy=None, max_size=None, **more) as stream,
        ):
            for _ in stream:
                pass

    threading.Thread(target=drain, args=("/viser/",), kwargs={"subprotocols": [protocol]}, daemon=True).start()
    threading.Thread(target=drain, args=("/api/telemetry?rate=20",), daemon=True).start()
    with contextlib.suppress(httpx.HTTPError), httpx.Client(base_url=f"http://127.0.0.1:{port}") as client:
        while True:
            client.get("/api/status")
            time.sleep(0.15)


def measure(presses: int) -> np.ndarray:
    """Return the latencies (presses,) [ms]."""
    found: list[float] = []
    with lab() as there:
        address = there["zaber"].removeprefix("socket://").split(":")
        with (
            relayed((address[0], int(address[1]))) as told,
            serving(settings=_bench(there, told.recv()), rate=None) as station,
            chromium() as browser,
        ):
            station.ready()
            viewers = [
                multiprocessing.get_context("spawn").Process(target=watch, args=(station.port,), daemon=True)
                for _ in range(VIEWERS)
            ]
            for viewer in viewers:
                viewer.start()
            time.sleep(5.0)
            with bare_page(browser, station) as page:
                page.evaluate(
                    "() => document.getElementById('stop').addEventListener('pointerdown',"
                    " (event) => { window.pressed = performance.timeOrigin + event.timeStamp; }, true)"
                )
                while len(found) < presses:
                    station.ready()
                    assert station.post("/api/start", RUN).status_code == 202
                    status = station.wait_for(lambda s: s["phase"] == "moving" or s["state"] != "RUNNING")
                    if status["state"] != "RUNNING":
                        print(f"not counted, the run ended by itself: {status['cause']}")  # noqa: T201
                        continue
                    time.sleep(0.3)
                    heard(told)
                    page.locator("#stop").click()
                    station.wait_for(lambda s: s["state"] == "STOPPED")
                    time.sleep(0.2)
                    pressed = 1e-3 * float(page.evaluate("() => window.pressed"))
                    stops = heard(told)
                    found.append(1e3 * (stops[min(AXES, len(stops)) - 1] - pressed))
            for viewer in viewers:
                viewer.terminate()
                viewer.join()
    return np.array(found)


def _bench(there: dict[str, Any], port: int) -> str:
    boxes = []
    for box in there["netft"]:
        rdt, page = urlsplit(box["rdt"]), urlsplit(box["page"])
        boxes.append(f"{box['tube']} = {{ host = '{rdt.hostname}', rdt_port = {rdt.port}, http_port = {page.port} }}")
    return f"""
[devices.stages]
driver = "zaber"
port = "socket://127.0.0.1:{port}"
deadline = 0.5  # the relay and a busy machine take their time
[devices.tracker]
driver = "aurora"
port = "{there["aurora"]}"
mount = {{ position = [0.0, 0.0, -0.2], rotation_vector = [{math.pi}, 0.0, 0.0] }}
[devices.sensors]
driver = "netft"
[devices.sensors.tubes]
{chr(10).join(boxes)}
"""


def main() -> None:
    """Measure the latency and print how busy the computer was, because a busy computer increases the latency."""
    presses = int(sys.argv[1]) if len(sys.argv) > 1 else 50
    load, before, begun = os.getloadavg()[0], stolen_seconds(), time.monotonic()
    latencies = measure(presses)
    p50, p99 = np.percentile(latencies, [50, 99])
    print(f"{len(latencies)} presses: median {p50:.0f} ms, p99 {p99:.0f} ms, max {latencies.max():.0f} ms")  # noqa: T201
    print(  # noqa: T201
        f"machine: {os.cpu_count()} processors, load {load:.2f} before and {os.getloadavg()[0]:.2f} after (this"
        f" measurement and its browser included), {stolen_seconds() - before:.1f} s stolen in"
        f" {time.monotonic() - begun:.0f} s"
    )
    if load > 0.5:
        print("the machine was busy before the first press: repeat this on a quiet one")  # noqa: T201


if __name__ == "__main__":
    main()
