"""Description of the API (OpenAPI), from which the page builds its forms; generated at its first request."""

import asyncio

from fastapi import FastAPI
from starlette.types import ASGIApp, Receive, Scope, Send

#: Path of the description.
DESCRIPTION_PATH = "/api/openapi.json"


def described_on_demand(app: FastAPI) -> ASGIApp:
    """Wrap `app` so that a thread generates the description at the first request for it; later requests reuse it.

    The description takes a quarter of a second of processor time, which a start without a page does not need. Without
    the thread, the event loop would be blocked meanwhile, and with it STOP.
    """

    async def described(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["path"] == DESCRIPTION_PATH:
            await asyncio.to_thread(app.openapi)
        await app(scope, receive, send)

    return described
