"""The message gate of the scene, under messages that no normal browser sends."""

import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from web.access.identity import Role, Sender
from web.access.lease import LEASE_S, Lease
from web.scene.proxy import MAX_BURST, MAX_CAMERA_DISTANCE, MAX_MESSAGE_BYTES, MAX_RATE_HZ, HandleBox, MessageGate

GIZMOS = {"/target": HandleBox((-1.0, -1.0, 0.0), (1.0, 1.0, 2.0))}
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [0, 0, 1.5], "fov": 1.0, "near": 0.1,
    "far": 10.0, "image_height": 100, "image_width": 100, "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
}  # fmt: skip
PRESS = {"type": "GuiUpdateMessage", "uuid": "views", "updates": {"value": "Top"}}
MOVE = {
    "type": "TransformControlsUpdateMessage", "name": "/target", "wxyz": [1, 0, 0, 0],
    "position": [0.5, -0.5, 1.0], "owner": "",
}  # fmt: skip
START = {"type": "TransformControlsDragStartMessage", "name": "/target", "owner": ""}
END = {"type": "TransformControlsDragEndMessage", "name": "/target", "owner": ""}


class Bench:
    """A message gate with the test's clock, a lease and the gate's reports."""

    def __init__(self, role: Role = Role.OPERATOR, *, holds: bool = True) -> None:
        self.now = 0.0
        self.reported: list[str] = []
        self.lease = Lease(lambda: self.now)
        if holds:
            self.lease.take("me-myself", "Me")
        who = Sender(role, "me-myself", "Me", "127.0.0.1")
        self.gate = MessageGate(GIZMOS, self.lease, who, lambda: self.now, self.reported.append)

    def say(self, message: Any) -> Any:
        passed = self.gate.passes(msgspec.msgpack.encode(message))
        return None if passed is None else msgspec.msgpack.decode(passed)


@pytest.mark.parametrize("message", [CAMERA, MOVE, MOVE | {"wxyz": [0.5, -0.5, 0.5, 0.5]}, START, END])
def test_scene_messages_of_an_operators_browser_pass_unchanged(message: dict) -> None:
    assert Bench().say(message) == message


@pytest.mark.parametrize("bench", [Bench(Role.VIEWER), Bench(holds=False), Bench(Role.VIEWER, holds=False)])
def test_clients_without_the_lease_move_their_camera_but_drag_nothing(bench: Bench) -> None:
    assert bench.say(CAMERA) == CAMERA
    for message in (MOVE, START, END):
        assert bench.say(message) is None
    assert bench.reported == ["a drag by a client that is not operator"]


def test_a_client_with_an_expired_lease_drags_nothing() -> None:
    bench = Bench()
    assert bench.say(MOVE) is not None
    bench.now = LEASE_S + 1.0
    assert bench.say(MOVE) is None


@pytest.mark.parametrize(
    "message",
    [
        {"type": "GuiRemoveMessage", "uuid": "views"},
        {"type": "RemoveSceneNodeMessage", "name": "/robot"},
        {"type": "ShareUrlRequest"},
        {"type": "RunJavascriptMessage", "source": "alert(1)"},
        {"type": "FileTransferStartUpload", "source_component_uuid": "views", "transfer_uuid": "x"},
        {"type": "GuiButtonHoldMessage", "uuid": "views", "frequency": 1e9},
        {"type": "SetPositionMessage", "name": "/robot", "position": [0, 0, 0]},
        {"type": "ScenePointerMessage", "event_type": "click"},
        {"type": 7},
        {},
        [],
        None,
        "ViewerCameraMessage",
        PRESS,
        CAMERA | {"more": 1},
        MOVE | {"name": "/robot/inner"},
        MOVE | {"owner": "client"},
        MOVE | {"position": [0.5, -0.5, 2.1]},
        MOVE | {"position": [math.nan, 0, 1]},
        MOVE | {"position": [0, 0]},
        MOVE | {"wxyz": [math.inf, 0, 0, 0]},
        MOVE | {"wxyz": [math.nan, 0, 0, 0]},
        MOVE | {"wxyz": [0, 0, 0, 0]},
        MOVE | {"wxyz": [1, 1, 1, 1]},
        CAMERA | {"position": [0, 0, math.nan]},
        CAMERA | {"position": [0, 0, 2 * MAX_CAMERA_DISTANCE]},
        CAMERA | {"image_height": 10**9},
        CAMERA | {"fov": -1.0},
    ],
)
def test_unknown_scene_messages_are_dropped_counted_and_reported_once(message: Any) -> None:
    bench = Bench()
    for _ in range(3):
        assert bench.say(message) is None
    assert sum(bench.gate.dropped.values()) == 3
    assert len(bench.reported) == 1


def test_text_empty_and_long_scene_messages_are_dropped() -> None:
    gate = Bench().gate
    for data in (
        "text",
        None,
        b"",
        msgspec.msgpack.encode(MOVE | {"name": "x" * MAX_MESSAGE_BYTES}),
        b"\x91" * MAX_MESSAGE_BYTES,
    ):
        assert gate.passes(data) is None


@given(st.binary(max_size=300))
def test_no_bytes_raise_an_exception_in_the_message_gate(data: bytes) -> None:
    Bench().gate.passes(data)


def test_a_flood_of_scene_messages_is_limited_to_the_allowed_rate() -> None:
    bench = Bench()
    assert sum(bench.say(CAMERA) is not None for _ in range(1000)) == MAX_BURST
    bench.now = 1.0
    assert sum(bench.say(CAMERA) is not None for _ in range(1000)) == MAX_RATE_HZ
