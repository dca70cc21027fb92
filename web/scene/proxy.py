"""Proxy on the station's public port for viser's page and WebSocket, with a filter for the browsers' messages.

viser listens on loopback only and has no access control, so the checks of `web.access` apply before the proxy. The
path of a page's request contains the page's identity, by which the proxy distinguishes the sockets of the pages.

viser executes every message of every client, so one client could remove or overwrite the objects that all clients see.
Only camera updates and drags by the operator pass the filter. A known message whose values are finite and in range is
encoded again and passed on.
"""

import asyncio
import math
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any, NamedTuple
from urllib.parse import quote, urlencode

import httpx
import msgspec
from fastapi import APIRouter, Request, Response, WebSocket, WebSocketDisconnect
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.typing import Subprotocol

from station.service.audit import Audit
from web.access.identity import Role, Sender, is_client, sender_of
from web.access.lease import Lease
from web.scene.cameras import CLIENT_PARAMETER

#: Longest accepted message of a browser [bytes]; a camera update has 300 bytes.
MAX_MESSAGE_BYTES = 2048
#: Largest number of messages that one socket may send in a burst, and its largest sustained rate [1/s].
MAX_BURST, MAX_RATE_HZ = 240.0, 120.0
#: Largest accepted coordinate of a camera [scene units]; from farther away nothing is visible.
MAX_CAMERA_DISTANCE = 1e4

Vec3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class _Message(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    pass


class _Camera(_Message, tag="ViewerCameraMessage"):
    wxyz: Quaternion
    position: Vec3
    fov: float
    near: float
    far: float
    image_height: int
    image_width: int
    look_at: Vec3
    up_direction: Vec3


class _Move(_Message, tag="TransformControlsUpdateMessage"):
    name: str
    wxyz: Quaternion
    position: Vec3
    owner: str = ""


class _MoveStart(_Message, tag="TransformControlsDragStartMessage"):
    name: str
    owner: str = ""


class _MoveEnd(_Message, tag="TransformControlsDragEndMessage"):
    name: str
    owner: str = ""


_decoder = msgspec.msgpack.Decoder(_Camera | _Move | _MoveStart | _MoveEnd)
_encoder = msgspec.msgpack.Encoder()


class HandleBox(NamedTuple):
    """Box within which a handle may be dragged [scene units]."""

    lower: Vec3
    upper: Vec3

    def contains(self, point: Vec3) -> bool:
        """Return whether a point is inside the box."""
        return all(low <= x <= up for low, x, up in zip(self.lower, point, self.upper, strict=True))


@dataclass
class MessageGate:
    """Filter for the messages of one browser's socket."""

    gizmos: Mapping[str, HandleBox]  #: handles that the operator may drag, by name
    lease: Lease
    who: Sender
    clock: Callable[[], float]  #: returns the time [s]
    report: Callable[[str], None]  #: called once for each reason, so that many messages cannot fill the log
    dropped: Counter[str] = field(default_factory=Counter)  #: number of dropped messages by reason
    _credit: float = MAX_BURST
    _last: float = 0.0

    def passes(self, data: bytes | str | None) -> bytes | None:
        """Return the message to pass on to viser; None: the message was dropped and counted in `dropped`."""
        now = self.clock()
        self._credit, self._last = min(MAX_BURST, self._credit + MAX_RATE_HZ * (now - self._last)), now
        if self._credit < 1.0:
            return self._drop("messages faster than a user can send them")
        self._credit -= 1.0
        if not isinstance(data, bytes) or len(data) > MAX_MESSAGE_BYTES:
            return self._drop("not a message of the scene")
        try:
            message = _decoder.decode(data)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
            return self._drop("an unknown or invalid message")
        refused = self._refusal(message)
        return _encoder.encode(message) if refused is None else self._drop(refused)

    def _refusal(self, message: Any) -> str | None:
        match message:
            case _Camera():
                numbers = (*message.wxyz, *message.position, *message.look_at, *message.up_direction)
                sizes = (message.fov, message.near, message.far, message.image_height, message.image_width)
                good = all(abs(x) <= MAX_CAMERA_DISTANCE for x in numbers) and all(0.0 < x <= 1e5 for x in sizes)
                return None if good else "a camera out of range"
            case _:
                return self._refused_drag(message)

    def _refused_drag(self, message: _Move | _MoveStart | _MoveEnd) -> str | None:
        box = self.gizmos.get(message.name)
        if box is None or message.owner:
            return "a drag of an object that cannot be dragged"
        if self.who.role is not Role.OPERATOR or not self.lease.holds(self.who.client):
            return "a drag by a client that is not operator"
        if not isinstance(message, _Move):
            return None
        turned = abs(math.hypot(*message.wxyz) - 1.0) <= 1e-3  # written so that NaN is refused, too
        return None if turned and box.contains(message.position) else "a drag out of range"

    def _drop(self, reason: str) -> None:
        if not self.dropped[reason]:
            self.report(reason)
        self.dropped[reason] += 1


#: Path under which the proxy serves viser. A page that sends an identity uses `IDENTITY_PATH` instead.
VISER_PREFIX = "/viser"
IDENTITY_PATH = VISER_PREFIX + "/as/{client}"
_FORWARDED_HEADERS = ("content-type", "content-encoding", "cache-control", "etag", "last-modified", "vary")


class SceneServer(NamedTuple):
    """Port of viser's server, the scene's draggable handles, and the number of open sockets of each client."""

    port: int  #: viser's port on loopback
    gizmos: Mapping[str, HandleBox]  #: handles that the operator may drag, by name
    open: Counter[str]  #: number of open sockets by the client's identity


def viser_routes(scene_server: SceneServer, lease: Lease, audit: Audit) -> tuple[APIRouter, httpx.AsyncClient]:
    """Return routes that forward `VISER_PREFIX` to viser, and their HTTP client, which the caller closes."""
    router = APIRouter(include_in_schema=False)
    # No proxy of the environment and no certificates: viser is on this computer.
    address = f"http://127.0.0.1:{scene_server.port}"
    client = httpx.AsyncClient(base_url=address, timeout=10.0, trust_env=False, verify=False)  # noqa: S501

    # The order matters: the last decorator registers first, and the first matching route is used.
    @router.get(VISER_PREFIX + "/{path:path}")
    @router.get(IDENTITY_PATH + "/{path:path}")
    async def page(path: str, request: Request) -> Response:
        forwarded = {
            name: value for name in ("accept-encoding", "if-none-match") if (value := request.headers.get(name))
        }
        try:
            # The raw bytes are forwarded, because the header `content-encoding` of a compressed body is forwarded, too.
            async with client.stream("GET", "/" + quote(path), headers=forwarded) as answer:
                body = b"".join([chunk async for chunk in answer.aiter_raw()])
        except httpx.HTTPError as error:
            return Response(f"the scene does not answer: {error}", status_code=502, media_type="text/plain")
        headers = {name: value for name in _FORWARDED_HEADERS if (value := answer.headers.get(name))}
        # viser's page has no entity tag; with one, a reload does not transfer 0.7 MB again.
        tag = headers.setdefault("etag", f'"{sha256(body).hexdigest()}"')
        headers |= {"cache-control": "no-cache", "vary": "accept-encoding"}
        if answer.status_code == 200 and request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers={"etag": tag})
        return Response(body, answer.status_code, headers)

    # The path without a trailing slash is needed, because viser's page requests its WebSocket without the slash.
    @router.websocket(IDENTITY_PATH)
    @router.websocket(IDENTITY_PATH + "/")
    async def identified(browser: WebSocket, client: str) -> None:
        who = sender_of(browser)
        await _serve(browser, who._replace(client=client) if is_client(client) else who)

    @router.websocket(VISER_PREFIX)
    @router.websocket(VISER_PREFIX + "/")
    async def anonymous(browser: WebSocket) -> None:
        await _serve(browser, sender_of(browser))

    async def _serve(browser: WebSocket, who: Sender) -> None:
        requested = [Subprotocol(name) for name in browser.scope.get("subprotocols", [])]
        try:
            scene = await connect(
                f"ws://127.0.0.1:{scene_server.port}/?{urlencode({CLIENT_PARAMETER: who.client})}",
                subprotocols=requested or None,
                max_size=None,
                compression=None,
                proxy=None,
            )
        except (OSError, WebSocketException):
            await browser.close(1011, "the scene does not answer")
            return
        await browser.accept(subprotocol=scene.subprotocol)

        def report(reason: str) -> None:
            audit.refused(str(who), "scene message", who.where, f"dropped: {reason}")

        gate = MessageGate(scene_server.gizmos, lease, who, time.monotonic, report)
        tasks = [asyncio.create_task(_to_scene(browser, scene, gate)), asyncio.create_task(_to_browser(scene, browser))]
        scene_server.open[who.client] += 1
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            scene_server.open[who.client] -= 1
            if not scene_server.open[who.client]:
                del scene_server.open[who.client]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await scene.close()

    return router, client


async def _to_scene(browser: WebSocket, scene: ClientConnection, gate: MessageGate) -> None:
    try:
        while True:
            message = await browser.receive()
            if message["type"] == "websocket.disconnect":
                return
            accepted = gate.passes(message.get("bytes"))
            if accepted is not None:
                await scene.send(accepted)
    except (ConnectionClosed, WebSocketDisconnect, RuntimeError):
        return  # the browser or viser has disconnected; the caller closes the other socket


async def _to_browser(scene: ClientConnection, browser: WebSocket) -> None:
    try:
        async for message in scene:
            if isinstance(message, str):
                await browser.send_text(message)
            else:
                await browser.send_bytes(message)
        await browser.close()
    except (ConnectionClosed, WebSocketDisconnect, RuntimeError):
        return
