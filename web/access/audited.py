"""Writes down every request that would change something, and every one that was refused, with what came of it.

Outermost, so that nothing passes it by: it sees what the gate refuses, too.
"""

import json
import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from station.service.audit import Audit
from web.access.gate import CHANGES
from web.access.refusals import Refusals

#: A held jog asks ten times a second: the same by the same sender within this time is one line [s].
REPEATED = "/api/jog"
QUIET = 1.0
#: Questions that are sent as a POST.
QUESTIONS = ("/api/model/solve", "/api/try", "/api/calibration/exchange")
#: So much of a body is kept [bytes].
KEPT = 400
#: Questions that nobody lets through are written down as well.
REFUSED = (401, 403)


class Audited:
    """The application inside, observed."""

    def __init__(self, app: ASGIApp, audit: Audit) -> None:
        self._app, self._audit = app, audit
        self._refusals = Refusals(audit)
        self._last: tuple[tuple[str, ...], float] = ((), 0.0)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let one connection through and note how it went."""
        self._refusals.sum_up()
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            self._refusals.sum_up(now=True)  # the application has ended
            return
        body, answer, status = bytearray(), bytearray(), 0

        async def heard() -> Message:
            message = await receive()
            body.extend(message.get("body", b"")[: KEPT - len(body)])
            return message

        async def said(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            elif message["type"] == "http.response.body" and status >= 400:
                answer.extend(message.get("body", b"")[: KEPT - len(answer)])
            elif message["type"] == "websocket.close" and message.get("code") == 1008:
                status = 403
                answer.extend(message.get("reason", "").encode())
            await send(message)

        try:
            await self._app(scope, heard, said)
        finally:
            method = scope.get("method", "websocket")
            changes = method in CHANGES and scope["path"] not in QUESTIONS
            if changes or status in REFUSED:
                self._note(scope, method, bytes(body), status, bytes(answer))

    def _note(self, scope: Scope, method: str, body: bytes, status: int, answer: bytes) -> None:
        who = scope.get("state", {}).get("who")
        where = str(scope["client"][0]) if scope.get("client") else "unknown"
        outcome = f"{status} {_reason(answer)}".strip() if status else "broken off"
        name = str(who) if who is not None else "unknown"
        if scope["path"] == REPEATED:
            key, now = (name, where, outcome), time.monotonic()
            repeated = key == self._last[0] and now - self._last[1] < QUIET
            self._last = (key, now)
            if repeated:
                return
        text = " ".join(body.decode("utf-8", "replace").split())
        write = self._refusals.add if status >= 400 else self._audit.write
        write(name, f"{method} {scope['path']} {text}".strip(), where, outcome)


def _reason(answer: bytes) -> str:
    try:
        return str(json.loads(answer)["error"])
    except (ValueError, KeyError, TypeError):
        return answer.decode("utf-8", "replace")
