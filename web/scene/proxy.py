"""Proxy on the station's public port for viser's page and WebSocket; the proxy filters the messages of the WebSocket.

viser listens on loopback only and has no access control, so the checks of `web.access` apply before the proxy. The
path of a page's request contains the page's identity, by which the proxy distinguishes the sockets of the pages.
"""

import asyncio
import time
from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple
from urllib.parse import quote, urlencode

import httpx
from fastapi import APIRouter, Request, Response, WebSocket, WebSocketDisconnect
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.typing import Subprotocol

from station.service.audit import Audit
from web.access.identity import Sender, is_client, sender_of
from web.access.lease import Lease
from web.scene.cameras import CLIENT_PARAMETER
from web.scene.messages import HandleBox, MessageGate

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
    client = httpx.AsyncClient(base_url=f"http://127.0.0.1:{scene_server.port}", timeout=10.0)

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
