"""viser behind the station's one public port: its page, and its websocket with a gate before it.

viser itself listens on loopback only and knows no access control; `access` stands before this. The
page asks for the scene under its own identity, so that its socket can be told from others'.
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
from web.access.identity import Who, is_client, who_of
from web.access.lease import Lease
from web.scene.cameras import CLIENT
from web.scene.messages import Box, Gate

#: Where the page finds viser; with an identity below `AS`.
PREFIX = "/viser"
AS = PREFIX + "/as/{client}"
_KEPT = ("content-type", "content-encoding", "cache-control", "etag", "last-modified", "vary")


class SceneServer(NamedTuple):
    """Where the scene is, and what of it can be touched."""

    port: int  #: viser's, on loopback
    gizmos: Mapping[str, Box]  #: what the operator may drag, by name
    open: Counter[str]  #: sockets through it, by their senders' identity


def viser_routes(scene_server: SceneServer, lease: Lease, audit: Audit) -> tuple[APIRouter, httpx.AsyncClient]:
    """Routes that pass everything under `PREFIX` on to viser, and the client to close."""
    router = APIRouter(include_in_schema=False)
    client = httpx.AsyncClient(base_url=f"http://127.0.0.1:{scene_server.port}", timeout=10.0)

    # The last decorator registers first, and the first route that fits is taken.
    @router.get(PREFIX + "/{path:path}")
    @router.get(AS + "/{path:path}")
    async def page(path: str, request: Request) -> Response:
        asked = {name: value for name in ("accept-encoding", "if-none-match") if (value := request.headers.get(name))}
        try:
            # Raw bytes: what viser compressed stays compressed.
            async with client.stream("GET", "/" + quote(path), headers=asked) as answer:
                body = b"".join([chunk async for chunk in answer.aiter_raw()])
        except httpx.HTTPError as error:
            return Response(f"the scene does not answer: {error}", status_code=502, media_type="text/plain")
        headers = {name: value for name in _KEPT if (value := answer.headers.get(name))}
        return Response(body, answer.status_code, headers)

    # A browser's socket arrives without the trailing slash of its page.
    @router.websocket(AS)
    @router.websocket(AS + "/")
    async def known(browser: WebSocket, client: str) -> None:
        who = who_of(browser)
        await _serve(browser, who._replace(client=client) if is_client(client) else who)

    @router.websocket(PREFIX)
    @router.websocket(PREFIX + "/")
    async def unknown(browser: WebSocket) -> None:
        await _serve(browser, who_of(browser))

    async def _serve(browser: WebSocket, who: Who) -> None:
        wanted = [Subprotocol(name) for name in browser.scope.get("subprotocols", [])]
        try:
            scene = await connect(
                f"ws://127.0.0.1:{scene_server.port}/?{urlencode({CLIENT: who.client})}",
                subprotocols=wanted or None,
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

        gate = Gate(scene_server.gizmos, lease, who, time.monotonic, report)
        tasks = [asyncio.create_task(_to_scene(browser, scene, gate)), asyncio.create_task(_back(scene, browser))]
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


async def _to_scene(browser: WebSocket, scene: ClientConnection, gate: Gate) -> None:
    try:
        while True:
            message = await browser.receive()
            if message["type"] == "websocket.disconnect":
                return
            passed = gate.passes(message.get("bytes"))
            if passed is not None:
                await scene.send(passed)
    except (ConnectionClosed, WebSocketDisconnect, RuntimeError):
        return  # either side has gone; the other is closed by the caller


async def _back(scene: ClientConnection, browser: WebSocket) -> None:
    try:
        async for message in scene:
            if isinstance(message, str):
                await browser.send_text(message)
            else:
                await browser.send_bytes(message)
        await browser.close()
    except (ConnectionClosed, WebSocketDisconnect, RuntimeError):
        return
