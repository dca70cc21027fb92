"""Logs every changing request and every refused request with its outcome.

This middleware wraps the whole application, so it also logs the requests that the access checks (`gate.py`) refuse.
"""

import json
import time
from collections.abc import Callable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from station.service.audit import Audit
from web.access.gate import CHANGING_METHODS
from web.access.refusals import Refusals
from web.access.repeats import Repeats

#: Path of the jog command. The page repeats this command ten times a second while a jog button is pressed, so equal
#: commands that one sender repeats within `REPEAT_INTERVAL_S` [s] have one line in the log.
REPEATED_PATH = "/api/jog"
REPEAT_INTERVAL_S = 1.0
#: Path of STOP. Every client may send STOP at any rate, so the log omits its body and counts its repeats.
STOP = "/api/stop"
#: Paths of POST requests that only query the station; these requests are logged only if access to them is refused.
QUERY_PATHS = ("/api/model/solve", "/api/waypoints/check", "/api/calibration/exchange")
#: Largest number of bytes of a request's body that are logged; also of the body of a refusal.
MAX_BODY_BYTES = 400
#: Status codes of refused access; queries with these codes are logged although a query changes nothing.
REFUSAL_STATUSES = (401, 403)


class AuditMiddleware:
    """Middleware that passes requests on to the wrapped application and logs them."""

    def __init__(self, app: ASGIApp, audit: Audit, clock: Callable[[], float] = time.monotonic) -> None:
        self._app, self._audit, self._clock = app, audit, clock
        self._refusals, self._repeats = Refusals(audit, clock), Repeats(audit, clock)
        self._last: tuple[tuple[str, ...], float] = ((), 0.0)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass one connection on to the application and log its outcome."""
        self._refusals.sum_up()
        self._repeats.sum_up()
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            self._refusals.sum_up(now=True)  # summaries are written now, because the application has ended
            self._repeats.sum_up(now=True)
            return
        body, answer, status = bytearray(), bytearray(), 0

        async def receive_logged() -> Message:
            message = await receive()
            body.extend(message.get("body", b"")[: MAX_BODY_BYTES - len(body)])
            return message

        async def send_logged(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            elif message["type"] == "http.response.body" and status >= 400:
                answer.extend(message.get("body", b"")[: MAX_BODY_BYTES - len(answer)])
            elif message["type"] == "websocket.close" and message.get("code") == 1008:
                status = 403
                answer.extend(str(message.get("reason") or "").encode())
            await send(message)

        try:
            await self._app(scope, receive_logged, send_logged)
        finally:
            method = scope.get("method", "websocket")
            changes = method in CHANGING_METHODS and scope["path"] not in QUERY_PATHS
            if changes or status in REFUSAL_STATUSES:
                self._log(scope, method, bytes(body), status, bytes(answer))

    def _log(self, scope: Scope, method: str, body: bytes, status: int, answer: bytes) -> None:
        who = scope.get("state", {}).get("who")
        where = str(scope["client"][0]) if scope.get("client") else "unknown"
        outcome = f"{status} {_reason(answer)}".strip() if status else "disconnected"
        name = str(who) if who is not None else "unknown"
        if scope["path"] == REPEATED_PATH:
            key, now = (name, where, outcome), self._clock()
            repeated = key == self._last[0] and now - self._last[1] < REPEAT_INTERVAL_S
            self._last = (key, now)
            if repeated:
                return
        if scope["path"] == STOP and status < 400:
            role = str(who.role) if who is not None else "unknown"
            self._repeats.add(name, role, f"{method} {STOP}", where, outcome)
            return
        text = " ".join(body.decode("utf-8", "replace").split())
        write = self._refusals.add if status >= 400 else self._audit.write
        write(name, f"{method} {scope['path']} {text}".strip(), where, outcome)


def _reason(answer: bytes) -> str:
    try:
        return str(json.loads(answer)["error"])
    except (ValueError, KeyError, TypeError):
        return answer.decode("utf-8", "replace")
