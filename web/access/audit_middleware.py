"""Logs every changing request and every refused request with its outcome.

This middleware wraps the whole application, so it also logs the requests that the access checks (`gate.py`) refuse.
Any client can cause refusals and STOPs without limit. Only a limited number of them is logged in full each minute;
further ones are logged as counts.
"""

import json
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from station.control.commands import Jog, Stop
from station.service.audit import Audit
from web.access.gate import CHANGING_METHODS, STOP_CHECK

#: Interval of the summaries [s], and number of refusals that are logged in full in one interval.
SUMMARY_INTERVAL_S, MAX_WRITTEN = 60.0, 100


class Refusals:
    """Log of refused requests: the first requests are written in full, further ones are counted. Not thread-safe.

    The number of lines is limited because a page of another site can send thousands of different requests a second.
    """

    def __init__(self, audit: Audit, clock: Callable[[], float] = time.monotonic) -> None:
        self._audit, self._clock = audit, clock
        self._until = 0.0
        self._written = 0
        self._more: Counter[str] = Counter()  # number of refusals that were only counted, by network address

    def add(self, who: str, what: str, where: str, outcome: str) -> None:
        """Log or count one refused request."""
        self.sum_up()
        if not self._written:
            self._until = self._clock() + SUMMARY_INTERVAL_S
        if self._written < MAX_WRITTEN:
            self._written += 1
            self._audit.refused(who, what, where, outcome)
        else:
            self._more[where] += 1

    def sum_up(self, *, now: bool = False) -> None:
        """Log how many refusals were only counted, if the interval is over or if `now` is true."""
        if not self._written or (self._clock() < self._until and not now):
            return
        if self._more:
            where = ", ".join(address for address, _ in self._more.most_common(5)) + ", ..." * (len(self._more) > 5)
            self._audit.refused("several", f"{self._more.total()} more requests", where, "refused within a minute")
        self._written = 0
        self._more.clear()


#: Interval of the summaries [s]; number of full log lines of one sender in an interval; number of senders that are
#: counted separately.
PERIOD_S, MAX_LINES, MAX_SENDERS = 60.0, 3, 20


@dataclass
class _Minute:
    """Commands of one sender during the minute after its first logged line."""

    until: float
    #: names and outcomes of the commands that already have a log line
    written: set[tuple[str, str]] = field(default_factory=set[tuple[str, str]])
    repeats: int = 0
    first: str = ""  #: time of day of the first repeat
    last: str = ""  #: time of day of the last repeat


class Repeats:
    """Log of repeated commands: the first commands are written in full, further ones are counted. Not thread-safe.

    Senders are distinguished by role and network address, because a client may change its name with every request.
    """

    def __init__(self, audit: Audit, clock: Callable[[], float] = time.monotonic) -> None:
        self._audit, self._clock = audit, clock
        self._senders: dict[tuple[str, str, str], _Minute] = {}  # commands by sender: role, address and command

    def add(self, who: str, role: str, what: str, where: str, outcome: str) -> None:
        """Log or count one accepted command."""
        self.sum_up()
        sender = role, where, what
        if sender not in self._senders and len(self._senders) >= MAX_SENDERS:
            sender = role, "several", what
        minute = self._senders.setdefault(sender, _Minute(self._clock() + PERIOD_S))
        if (who, outcome) not in minute.written and len(minute.written) < MAX_LINES:
            minute.written.add((who, outcome))
            self._audit.write(who, what, where, outcome)
            return
        minute.repeats += 1
        minute.last = f"{datetime.now().astimezone():%H:%M:%S}"
        minute.first = minute.first or minute.last

    def sum_up(self, *, now: bool = False) -> None:
        """Log the number of repeats of each sender whose minute is over; with `now`, of all senders."""
        for sender, minute in list(self._senders.items()):
            if not now and self._clock() < minute.until:
                continue
            del self._senders[sender]
            if minute.repeats:
                role, where, what = sender
                names = {name for name, _ in minute.written}
                who = names.pop() if len(names) == 1 else f"several ({role})"
                outcome = f"repeated {minute.repeats} times, first {minute.first}, last {minute.last}"
                self._audit.write(who, what, where, outcome)


#: Path of the jog command. The page repeats it ten times a second while a jog button is pressed. Equal commands that
#: one sender repeats within `REPEAT_INTERVAL_S` [s] therefore have one line in the log.
REPEATED_PATH = Jog.path()
REPEAT_INTERVAL_S = 1.0
#: Path of STOP. Every client may send STOP at any rate, so the log omits its body and counts its repeats.
STOP = Stop.path()
#: Paths of POST requests that only query the station; these requests are logged only if access to them is refused.
QUERY_PATHS = (STOP_CHECK, "/api/model/solve", "/api/waypoints/check", "/api/calibration/exchange")
#: Largest number of bytes that are logged of a request's body, and of the body of a refusal.
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
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                status = message["status"]
            elif message["type"] in ("http.response.body", "websocket.http.response.body") and status >= 400:
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
