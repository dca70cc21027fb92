"""The gateway of a live station: targets move the tip only in a run started for them."""

import json
import socket
import time
from collections.abc import Iterator

import numpy as np
import psutil
import pytest
from pyigtl import OpenIGTLinkClient
from pyigtl.messages import TransformMessage
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from core.robot.robot import Array
from tests.harness.gateway_clients import igtl_client
from tests.harness.serving import Served, serving
from web.gateway.igtl import MAX_CLIENTS

WIDE = {"silence": 2.0, "end": 5.0}  # the station's clock is slow and the computer busy
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    with serving("--igtl", "0", "--foxglove", "0.0.0.0:0") as served:
        served.ready()
        yield served


@pytest.fixture
def client(served: Served) -> Iterator[OpenIGTLinkClient]:
    with igtl_client(served) as client:
        yield client


def test_an_openigtlink_target_moves_nothing_without_a_run_for_targets(
    served: Served, client: OpenIGTLinkClient
) -> None:
    before, goal = served.status()["joints"], _desired(client) + UP * 3.0
    for _ in range(20):
        _aim(client, goal)
    status = served.status()
    assert status["state"] == "READY"
    assert status["joints"] == pytest.approx(before, abs=1e-6)


def test_the_tip_follows_an_openigtlink_target_in_a_run_started_by_an_operator(
    served: Served, client: OpenIGTLinkClient
) -> None:
    assert served.child("ctr-gateway").status() != psutil.STATUS_ZOMBIE
    assert served.post("/api/gateway/target", WIDE).status_code == 202
    served.wait_for(lambda status: status["phase"] == "moving")
    start = _desired(client)
    goal = start + UP * 2.0
    while np.abs(_desired(client) - goal).max() > 0.02:
        _aim(client, goal)
        served.status()  # any request of the operator renews the operator's lease
        _aim(client, start + UP * 500.0)  # a target beyond the reach has no effect
    # The operator loses the lease, so later targets have no effect and the run ends.
    other = {"x-ctr-client": "other-0123456789", "x-ctr-name": "other"}
    served.rest.post("/api/operator", json={"take_over": True}, headers=other)
    try:
        while served.status()["state"] == "RUNNING":
            _aim(client, start)
        # The tip keeps its position: at rest the desired position equals the measured position.
        assert np.abs(_desired(client) - goal).max() < 0.5
    finally:
        served.rest.delete("/api/operator", headers=other)
    for outcome in ("started", "ended"):  # the station writes the end after the state has changed
        served.wait_for(lambda _, outcome=outcome: ("targets of run", outcome) in _log(served))


def test_foxglove_beyond_loopback_requires_a_token_and_receives_the_gains(served: Served) -> None:
    (line,) = [line for line in served.said.read_text().splitlines() if line.startswith("Foxglove is at ws://0.0.0.0:")]
    address, _, token = line.removeprefix("Foxglove is at ").replace("0.0.0.0", "127.0.0.1").partition("?token=")
    spoken = ["foxglove.websocket.v1"]
    with pytest.raises(InvalidStatus) as refusal:
        connect(address, subprotocols=spoken, proxy=None)
    assert refusal.value.response.status_code == 401
    with connect(f"{address}?token={token}", subprotocols=spoken, proxy=None) as client:
        assert json.loads(client.recv())["op"] == "serverInfo"
        assert json.loads(client.recv())["op"] == "advertise"
        client.send(json.dumps({"op": "getParameters", "parameterNames": ["controller.k1", "controller.strategy"]}))
        told = {each["name"]: each["value"] for each in json.loads(client.recv())["parameters"]}
    controller = served.rest.get("/api/controller").json()
    assert told == {f"controller.{key}": controller[key] for key in ("k1", "strategy")}


def test_openigtlink_refuses_a_client_beyond_the_limit_with_the_reason(served: Served) -> None:
    (line,) = [line for line in served.said.read_text().splitlines() if line.startswith("OpenIGTLink is at")]
    address = ("127.0.0.1", int(line.rpartition(":")[2]))
    clients = [socket.create_connection(address) for _ in range(MAX_CLIENTS)]
    try:
        for client in clients:
            client.settimeout(60.0)
            assert client.recv(1)  # the station serves the client
        with socket.create_connection(address) as late:
            late.settimeout(60.0)
            said = b""
            while more := late.recv(4096):
                said += more
        assert said[2:8] == b"STATUS"
        assert f"{MAX_CLIENTS} clients are connected, the limit is {MAX_CLIENTS}".encode() in said
    finally:
        for client in clients:
            client.close()


def test_the_loop_and_the_page_continue_when_the_gateway_is_killed(served: Served) -> None:
    served.ready()
    assert served.status()["devices"]["gateway"] == {"severity": 0, "condition": "connected", "text": ""}
    served.child("ctr-gateway").kill()
    status = served.wait_for(lambda status: status["devices"]["gateway"]["severity"] == 1)
    text = "the gateway ended by signal 9: its clients receive no more data; restart the station"
    assert status["devices"]["gateway"] == {"severity": 1, "condition": "closed", "text": text}
    assert status["warnings"][-1] == text
    assert served.post("/api/start", {"experiment": "fig7"}).status_code == 202
    served.wait_for(lambda status: status["phase"] in ("settling", "moving"))
    served.post("/api/stop")
    log = served.rest.get("/api/log").json()
    assert any(entry["what"] == "gateway" and "signal 9" in entry["outcome"] for entry in log)
    served.ready()


def _log(served: Served) -> set[tuple[str, str]]:
    """Return the first three words and the outcome of each entry in the station's log."""
    entries = served.rest.get("/api/log").json()
    return {(" ".join(entry["what"].split()[:3]), entry["outcome"]) for entry in entries}


def _desired(client: OpenIGTLinkClient) -> Array:
    """Return the desired tip from a message that is newer than all queued ones."""
    client.get_latest_messages()
    message = client.wait_for_message("TipDesired", timeout=30)
    return message.matrix[:3, 3]


def _aim(client: OpenIGTLinkClient, place: Array) -> None:
    matrix = np.eye(4)
    matrix[:3, 3] = place
    client.send_message(TransformMessage(matrix, device_name="Target"))
    time.sleep(0.02)
