"""viser behind the station's one public port: its page and its websocket, passed through unchanged.

viser itself listens on loopback only and knows no access control; `access` stands before this.
"""

import asyncio
from urllib.parse import quote

import httpx
from fastapi import APIRouter, Request, Response, WebSocket, WebSocketDisconnect
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, WebSocketException
from websockets.typing import Subprotocol

#: Where the page finds viser.
PREFIX = "/viser"
_KEPT = ("content-type", "content-encoding", "cache-control", "etag", "last-modified", "vary")


def viser_routes(port: int) -> tuple[APIRouter, httpx.AsyncClient]:
    """Routes that pass everything under `PREFIX` on to viser on a loopback `port`, and the client to close."""
    router = APIRouter(include_in_schema=False)
    client = httpx.AsyncClient(base_url=f"http://127.0.0.1:{port}", timeout=10.0)

    @router.get(PREFIX + "/{path:path}")
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

    @router.websocket(PREFIX)
    @router.websocket(PREFIX + "/")
    async def socket(browser: WebSocket) -> None:
        wanted = [Subprotocol(name) for name in browser.scope.get("subprotocols", [])]
        try:
            scene = await connect(
                f"ws://127.0.0.1:{port}/", subprotocols=wanted or None, max_size=None, compression=None, proxy=None
            )
        except (OSError, WebSocketException):
            await browser.close(1011, "the scene does not answer")
            return
        await browser.accept(subprotocol=scene.subprotocol)
        tasks = [asyncio.create_task(_to_scene(browser, scene)), asyncio.create_task(_to_browser(scene, browser))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await scene.close()

    return router, client


async def _to_scene(browser: WebSocket, scene: ClientConnection) -> None:
    try:
        while True:
            message = await browser.receive()
            if message["type"] == "websocket.disconnect":
                return
            await scene.send(message["bytes"] if message.get("bytes") is not None else message["text"])
    except (ConnectionClosed, WebSocketDisconnect, RuntimeError):
        return  # either side has gone; the other is closed by the caller


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
