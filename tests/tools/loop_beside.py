"""Measure the punctuality of the control loop while browsers or gateway clients use the station.

    python -m tests.tools.loop_beside [nothing] [page] [gateway] [crtk] [cameras] [--seconds S] [--times N]
                                      [--config FILE]

`ctr-station bench loop` runs only the control process, the lab and the recorder. Here the web server shares their
processors; `page` adds a Chromium that draws the page, `gateway` adds all four protocols with two clients each, `crtk`
adds a client of ROS 2 that moves the tip by `servo_cp` at 200 Hz and receives every topic, and `cameras` adds two
simulated cameras (640 x 480, 30 frames/s), which the run records and whose pictures a client views. Separate stations
take turns, each with one recorded motion under load (`crtk`: without load). The output has the loop's timing, the time
that the hypervisor has taken from this computer, and the ratio of the medians to those of the first named setup. A
station file with `fifo = false` measures without real-time scheduling.
"""

import argparse
import json
import math
import os
import socket
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil
import pylsl
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from station.benchmarks.loop import TimerProbe, figures, stolen_seconds
from station.benchmarks.served import ServedStation as TelemetryOf
from station.config.robots import load_robot
from station.control.ring import RUN, Ring
from station.control.telemetry import Channels
from tests.harness.chromium import SIZE, chromium
from tests.harness.crtk_peer import POSE, Peer, pose, xyz
from tests.harness.gateway_clients import zenoh_session
from tests.harness.serving import Served, free_port, serving

MOTION = {
    "trajectory": {"kind": "circle", "radius": 0.010, "period": 20.0},
    "load": {"kind": "raised_cosine", "peak": 0.3, "period": 15.0},
}
#: Agreement of a run for targets, which a busy computer does not end.
TARGETS = {"reach": 0.03, "silence": 2.0, "end": 30.0}
#: Time for the clients to connect, and time from the start of the run until the robot moves [s].
BEGUN, MOVING = 10.0, 5.0
#: Tables of two simulated cameras at right angles.
CAMERAS = """
[cameras.side]
[cameras.top]
pose = { position = [-0.4, 0.0, 0.13], rotation_vector = [2.221441469079183, 0.0, 2.221441469079183] }
"""
#: Number of clients of each protocol.
CLIENTS = 2


@contextmanager
def page(station: Served, _: dict[str, int]) -> Iterator[None]:
    """Keep the page open in a Chromium that draws the page and its scene."""
    with chromium() as browser:
        browser.new_page(viewport=SIZE).goto(station.url)
        yield


@contextmanager
def gateway(_: Served, ports: dict[str, int]) -> Iterator[None]:
    """Keep clients of all protocols connected, which receive all messages."""
    context = get_context("spawn")
    clients = [
        context.Process(target=client, args=(ports.get(client.__name__, 0),), daemon=True)
        for client in (igtl, foxglove, ros2, lsl)
        for _ in range(CLIENTS)
    ]
    for each in clients:
        each.start()
    yield
    assert all(each.is_alive() for each in clients), [(each.name, each.exitcode) for each in clients]
    for each in clients:
        each.kill()
        each.join()


@contextmanager
def nothing(_: Served, __: dict[str, int]) -> Iterator[None]:
    """Connect no client."""
    yield


@contextmanager
def cameras(station: Served, _: dict[str, int]) -> Iterator[None]:
    """Keep a client connected that receives the pictures of both cameras."""
    context = get_context("spawn")
    viewers = [context.Process(target=viewer, args=(station.url, name), daemon=True) for name in ("side", "top")]
    for each in viewers:
        each.start()
    yield
    assert all(each.is_alive() for each in viewers)
    for each in viewers:
        each.kill()
        each.join()


def viewer(url: str, name: str) -> None:
    """Run a client that receives all pictures of a camera."""
    with httpx.stream("GET", f"{url}/api/cameras/{name}/stream", timeout=60.0) as answer:
        for _ in answer.iter_raw():
            pass


def igtl(port: int) -> None:
    """Run an OpenIGTLink client that reads all messages."""
    with socket.create_connection(("127.0.0.1", port)) as client:
        while client.recv(1 << 16):
            pass


def foxglove(port: int) -> None:
    """Run a Foxglove client that subscribes to every channel."""
    address, spoken = f"ws://127.0.0.1:{port}/", [Subprotocol("foxglove.sdk.v1")]
    with connect(address, subprotocols=spoken, proxy=None, max_size=None) as client:
        for received in client:
            message = json.loads(received) if isinstance(received, str) else {}
            if message.get("op") == "advertise":
                wish = [{"id": each["id"], "channelId": each["id"]} for each in message["channels"]]
                client.send(json.dumps({"op": "subscribe", "subscriptions": wish}))


def ros2(port: int) -> None:
    """Run a Zenoh client that subscribes to every ROS 2 topic."""
    with zenoh_session(port) as session:
        session.declare_subscriber("0/**", lambda _: None)
        time.sleep(1e6)


@contextmanager
def crtk(_: Served, ports: dict[str, int]) -> Iterator[None]:
    """Keep a client of CRTK connected that sends `servo_cp` at 200 Hz and receives all messages."""
    context = get_context("spawn")
    started = context.Event()
    process = context.Process(target=servo, args=(ports["ros2"], started), daemon=True)
    process.start()
    assert started.wait(120.0)
    yield
    assert process.is_alive()
    process.kill()
    process.join()


def servo(port: int, started: Event) -> None:
    """Move the tip on a circle; the part of y below 1 mm has the time of sending [s, up to 1000], 1 um for a second."""
    peer = Peer(port, "servo")
    peer.session.declare_subscriber("0/**", lambda _: None)
    peer.subscribe("setpoint_cp", POSE)
    x, y, z = xyz(peer.wait("setpoint_cp", lambda message: message.header.stamp.sec).pose.position)
    peer.advertise("servo_cp", POSE)
    started.set()
    due = time.monotonic()
    while True:
        now = time.monotonic()
        angle = 0.5 * now
        sent = math.floor(1e3 * y) / 1e3 + 1e-6 * (now % 1000.0)
        peer.send("servo_cp", pose((x + 0.004 * math.sin(angle), sent, z + 0.004 * math.cos(angle))))
        due = max(due + 0.005, now)
        time.sleep(max(0.0, due - time.monotonic()))


def delays_ms(ring: Ring) -> dict[str, float]:
    """Return the delays from the sending of each `servo_cp` to the tick that is the first to use it [ms]."""
    rows, channels = ring.read(0)[0], Channels(load_robot("paper").robot())
    latest, row = ring.request(int(ring.counters[RUN])), ring.latest()
    if latest is None or latest.setpoint is None or row is None:
        return {"count": 0}  # a busy computer has stopped the run, or the client has not started yet
    start = latest.setpoint.time - float(channels.of(row, "request_time")[0])
    sent = channels.of(rows, "request")[:, 1] % 1e-3 * 1e6
    first = np.flatnonzero(np.diff(sent) != 0.0) + 1
    found = 1e3 * ((rows[first, 0] + start - sent[first]) % 1000.0)
    return {"median": float(np.median(found)), "p99": float(np.percentile(found, 99)), "count": len(found)}


def lsl(_: int) -> None:
    """Run an LSL client that receives every row."""
    inlet = pylsl.StreamInlet(pylsl.resolve_byprop("name", "ctr-station", 1, 60.0)[0])
    while True:
        inlet.pull_chunk(timeout=1.0)


BESIDE: dict[str, Callable[[Served, dict[str, int]], Any]] = {
    "nothing": nothing,
    "page": page,
    "gateway": gateway,
    "crtk": crtk,
    "cameras": cameras,
}
#: Tables of the station file for a setup.
TABLES = {"cameras": CAMERAS}


def measured(name: str, seconds: float, settings: str) -> dict[str, Any]:
    """Return the control loop's timing while the clients of setup `name` are connected."""
    protocols = {"gateway": ("igtl", "foxglove", "ros2"), "crtk": ("ros2",)}.get(name, ())
    ports = {protocol: free_port() for protocol in protocols}
    options = [word for protocol, port in ports.items() for word in (f"--{protocol}", str(port))]
    with ExitStack() as owned:
        probe = owned.enter_context(TimerProbe(max(os.sched_getaffinity(0))))
        station = owned.enter_context(
            serving(
                *options, *(["--lsl"] if name == "gateway" else []), settings=settings + TABLES.get(name, ""), rate=None
            )
        )
        station.ready()
        ring = owned.enter_context(TelemetryOf(station.url, station.process.pid, 0.0, 0.0).ring(load_robot("paper")))
        owned.enter_context(BESIDE[name](station, ports))
        time.sleep(BEGUN)
        motion = ("/api/gateway/target", TARGETS) if name == "crtk" else ("/api/start", MOTION)
        started = station.post(motion[0], {**motion[1], "duration": seconds + 60.0})
        assert started.status_code == 202, started.text
        time.sleep(MOVING)
        ring.clear_timing()
        probe.clear()
        before, used = stolen_seconds(), used_seconds(station)
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0:
            station.status()  # keeps the lease
            time.sleep(min(left, 2.0))
        later = used_seconds(station)
        status = station.status()
        result = {
            **figures(ring, seconds, stolen_seconds() - before),
            "computer": probe.figures(),
            "processors": {name: round((later[name] - used[name]) / seconds, 3) for name in used if name in later},
            **({"servo_cp_ms": delays_ms(ring)} if name == "crtk" and status["state"] == "RUNNING" else {}),
            "state": f"{status['state']} {status['cause']}".strip(),  # the cause, if the run ended in HOLD
        }
        station.post("/api/stop")
    return result


def used_seconds(station: Served) -> dict[str, float]:
    """Return the processor time of the station's processes [s], by name and pid."""
    main = psutil.Process(station.process.pid)
    return {f"{one.name()} {one.pid}": sum(one.cpu_times()[:2]) for one in (main, *main.children())}


def _over(figure: dict[str, float], other: dict[str, float]) -> dict[str, float]:
    return {key: round(figure[key] / max(other[key], 1e-9), 2) for key in other}


def main() -> None:
    """Measure each setup and print the control loop's timing as JSON."""
    parser = argparse.ArgumentParser(prog="python -m tests.tools.loop_beside")
    parser.add_argument("beside", nargs="+", choices=list(BESIDE))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--times", type=int, default=1, help="stations of each, in turns")
    parser.add_argument("--config", help="station file of the paper's robot")
    parsed = parser.parse_args()
    settings = Path(parsed.config).read_text(encoding="utf-8") if parsed.config else ""
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in parsed.beside}
    for _ in range(parsed.times):
        for name, results in found.items():
            results.append(measured(name, parsed.seconds, settings))
            sys.stdout.write(f"{json.dumps({name: results[-1]})}\n")
            sys.stdout.flush()
    medians = {
        name: {
            part: {key: statistics.median(each[part][key] for each in results) for key in results[0][part]}
            for part in ("late_us", "tick_us")
        }
        for name, results in found.items()
    }
    first = medians[parsed.beside[0]]
    ratios = {name: {part: _over(each[part], first[part]) for part in first} for name, each in medians.items()}
    sys.stdout.write(f"{json.dumps({'medians': medians, 'ratios': ratios})}\n")


if __name__ == "__main__":
    main()
