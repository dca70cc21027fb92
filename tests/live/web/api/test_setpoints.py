"""Setpoint streams to a live station."""

import json
import math
from socket import SHUT_RDWR

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from station.client import Setpoints, Station, StationError
from tests.harness.serving import Served
from tests.harness.waiting import NET

WIDE = {"silence": 2.0, "end": 20.0}  # the station's clock is slow and the computer busy


def test_a_script_streams_setpoints_and_receives_the_tips_state(station: Served) -> None:
    with Station(station.url) as script:
        with script.setpoints(**WIDE) as tip:
            for now in tip.every(0.02, NET):
                answer = tip.go(0.0, 0.0, min(0.004, 0.002 * now))
                if now > 2.0 and answer["desired"][2] - tip.start[2] > 0.0005:
                    break
            assert {"time", "measured", "estimated", "desired", "force", "error", "held_back"} <= set(answer)
            way = np.subtract(answer["desired"], tip.start)
            assert way[2] > 0.0005
            assert np.abs(way[:2]).max() < 1e-9
            with pytest.raises(StationError, match="beyond the reach of 50 mm"):
                tip.go(1.0, 0.0, 0.0)
            tip.move(0.0, 0.0, -0.001)
        assert script.wait(tip.run)["state"] == "READY"
        file = script.runs()[0]
        assert file["id"] == tip.run


def test_invalid_setpoints_are_refused_with_the_reason_and_the_run_continues(station: Served) -> None:
    with connect(f"ws://127.0.0.1:{station.port}/api/setpoints", proxy=None) as socket:
        socket.send(json.dumps(WIDE))
        assert "run_id" in json.loads(socket.recv())
        begun = json.loads(socket.recv())
        assert begun.get("ready"), begun
        for lie in (
            '{"tip": [NaN, 0, 0]}', '{"tip": [1e400, 0, 0]}', '{"tip": [0, 0]}', '{"tip": ["0", 0, 0]}', '{"tip": [0,',
            '{"tip": [0, 0, 0], "velocity": [0, 0, 0]}', '{"velocity": [true, 0, 0]}', "null", "", '{"end": 1}',
            '{"velocity": [0, NaN, 0]}', '{"tip": [0, 0, 0], "time": NaN}', '{"tip": [0, 0, 0], "time": "now"}',
            '{"tip": [0, 0, 0], "direction": [0, 0]}', '{"tip": [0, 0, 0], "direction": [0, 0, 1]}',
            '{"tip": [0, 0, 0], "direction": "up"}', '{"tip": [0, 0, 0], "direction": null}',
            '{"direction": [0, 0, 1]}', '{"velocity": [0, 0, 0], "direction": [0, 0, 1]}',
            b'{"tip": [0, 0, 0]}', f'{{"tip": [1{400 * "0"}, 0, 0]}}', '{"tip": [1e308, 0, 0]}', '{"tip": [1, 0, 0]}',
        ):  # fmt: skip
            socket.send(lie)
            answer = json.loads(socket.recv())
            assert answer["refused"], lie
            assert math.isfinite(answer["time"])
        socket.send('{"tip": [0, 0, 0.001]}')
        assert json.loads(socket.recv())["refused"] == ""
        # a second stream of the same client, and a stream of another client, are refused
        other = {"x-ctr-client": "other-0123456789", "x-ctr-name": "other"}
        with connect(f"ws://127.0.0.1:{station.port}/api/setpoints", additional_headers=other, proxy=None) as second:
            second.send("{}")
            assert "is operator; ask them" in json.loads(second.recv())["error"]
        with connect(f"ws://127.0.0.1:{station.port}/api/setpoints", proxy=None) as second:
            second.send("{}")
            assert "RUNNING" in json.loads(second.recv())["error"]
        assert station.status()["state"] == "RUNNING"
        with pytest.raises(ConnectionClosed):
            _flood(socket)
    station.wait_for(lambda status: status["state"] == "READY")


def test_only_a_silent_client_gets_the_timeout_as_the_cause_of_the_end(station: Served) -> None:
    for last, cause in ((None, "no valid setpoint for 4 s"), ('{"end": true}', "")):
        with connect(f"ws://127.0.0.1:{station.port}/api/setpoints", proxy=None) as socket:
            socket.send(json.dumps({"silence": 0.2, "end": 4.0}))  # the computer may be busy for seconds
            assert "run_id" in json.loads(socket.recv())
            assert json.loads(socket.recv()).get("ready")
            socket.send('{"velocity": [0, 0, 0.005]}')
            assert json.loads(socket.recv())["refused"] == ""
            if last is not None:
                socket.send(last)
            assert json.loads(socket.recv()) == {"ended": "READY", "cause": cause}


def test_a_setpoint_client_that_loses_the_lease_is_refused_and_the_tip_comes_to_rest(station: Served) -> None:
    leader, other = ({"x-ctr-client": f"{name}-0123456789", "x-ctr-name": name} for name in ("leader", "other"))
    address = f"ws://127.0.0.1:{station.port}/api/setpoints"
    with connect(address, additional_headers=leader, proxy=None) as socket:
        socket.send(json.dumps({"silence": 0.2, "end": 2.0}))
        assert "run_id" in json.loads(socket.recv())
        assert json.loads(socket.recv()).get("ready")
        taken = station.rest.post("/api/operator", json={"take_over": True}, headers=other)
        try:
            assert taken.json()["you"]
            socket.send('{"velocity": [0, 0, 0.005]}')
            assert "'other' is operator" in json.loads(socket.recv())["refused"]
            assert json.loads(socket.recv()) == {"ended": "READY", "cause": "no valid setpoint for 2 s"}
        finally:
            station.rest.delete("/api/operator", headers=other)
    station.wait_for(lambda status: status["state"] == "READY")


def test_a_setpoint_message_that_is_far_too_long_ends_the_stream(station: Served) -> None:
    with connect(f"ws://127.0.0.1:{station.port}/api/setpoints", proxy=None) as socket:
        socket.send(json.dumps(WIDE))
        assert "run_id" in json.loads(socket.recv())
        assert json.loads(socket.recv()).get("ready")
        with pytest.raises((ConnectionClosed, OSError)):
            _say_too_much(socket)
    station.wait_for(lambda status: status["state"] == "READY")


def test_stop_ends_a_setpoint_stream_and_is_reported(station: Served) -> None:
    with Station(station.url) as script, script.setpoints(**WIDE) as tip:
        tip.move(0.0, 0.0, 0.001)
        assert script.stop() == ""
        with pytest.raises(StationError, match="STOPPED"):
            _go_on(tip)


def _say_too_much(socket: ClientConnection) -> None:
    """Send 10 MB in one message; return the station's messages until it disconnects."""
    socket.send('{"tip": [' + "0" * 10_000_000)
    while True:
        socket.recv()


def _flood(socket: ClientConnection) -> None:
    """Send far more messages than allowed; return the station's messages until it disconnects."""
    for _ in range(20_000):
        socket.send('{"velocity": [0, 0, 0]}')
    while True:
        socket.recv()


def _go_on(tip: Setpoints) -> None:
    for _ in tip.every(0.02, 60.0):
        tip.move(0.0, 0.0, 0.001)


@pytest.mark.parametrize("stays", [True, False], ids=["client that stays", "client that disconnects"])
def test_stream_and_lease_end_after_the_control_process_is_killed_while_the_run_settles(
    station: Served, stays: bool
) -> None:
    anna = {"x-ctr-client": "anna-0123456789", "x-ctr-name": "Anna"}
    with connect(f"ws://127.0.0.1:{station.port}/api/setpoints", additional_headers=anna, proxy=None) as socket:
        socket.send(json.dumps(WIDE))
        run = json.loads(socket.recv())["run_id"]
        station.wait_for(lambda status: status["phase"] == "settling")
        station.control_process().kill()
        if stays:
            last = json.loads(socket.recv(NET))
            assert last["error"].startswith(
                "the run ended before it moved: FAULT the control process ended by signal 9"
            )
    station.wait_for(lambda status: status["operator"]["name"] is None)
    assert f"setpoints of run {run}" in [
        entry["what"] for entry in station.rest.get("/api/log?count=20").json() if entry["outcome"] == "ended"
    ]


def test_stream_and_lease_end_after_the_client_is_gone_while_the_run_settles(station: Served) -> None:
    anna = {"x-ctr-client": "anna-0123456789", "x-ctr-name": "Anna"}
    with connect(f"ws://127.0.0.1:{station.port}/api/setpoints", additional_headers=anna, proxy=None) as socket:
        socket.send(json.dumps(WIDE))
        json.loads(socket.recv())
        station.wait_for(lambda status: status["phase"] == "settling")
        socket.socket.shutdown(SHUT_RDWR)  # without a close frame
    station.wait_for(lambda status: status["operator"]["name"] is None)
