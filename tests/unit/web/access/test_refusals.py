"""A flood of refused requests in the audit log: a few of them, their number, and every command."""

import asyncio
from pathlib import Path

from starlette.types import Message, Receive, Scope, Send

from station.service.audit import Audit
from web.access.audited import Audited
from web.access.gate import Access
from web.access.refusals import MOST, PERIOD, Refusals


async def _taken(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "http":
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})


async def _post(app: Audited, path: str, origin: str = "http://127.0.0.1:8000") -> None:
    async def receive() -> Message:
        return {"type": "http.request", "body": b""}

    async def send(_message: Message) -> None:
        pass

    headers = [(b"host", b"127.0.0.1:8000"), (b"origin", origin.encode())]
    scope = {"type": "http", "method": "POST", "path": path, "client": ("127.0.0.1", 5), "headers": headers}
    await app(scope, receive, send)


def test_it_is_summed_up_and_pushes_no_command_out(tmp_path: Path) -> None:
    audit = Audit(tmp_path, limit=20_000)
    app = Audited(Access(_taken, "127.0.0.1", 8000, None), audit)

    async def flood() -> None:
        await _post(app, "/api/start")
        for number in range(3000):
            await _post(app, "/api/start", f"http://{number}.evil.example")
        await _post(app, "/api/stop")
        await app({"type": "lifespan"}, None, None)  # type: ignore[arg-type]

    asyncio.run(flood())
    told = audit.tail(1000)
    audit.close()

    assert [entry.what for entry in told if entry.outcome == "200"] == ["POST /api/stop", "POST /api/start"]
    assert sum("evil.example" in entry.outcome for entry in told) == MOST
    assert [(entry.what, entry.where) for entry in told if entry.who == "several"] == [
        (f"{3000 - MOST} more requests", "127.0.0.1")
    ]


def test_a_new_minute_begins_with_the_number_of_the_last_one(tmp_path: Path) -> None:
    audit, times = Audit(tmp_path), [0.0]
    refusals = Refusals(audit, lambda: times[0])
    for count, times[0] in ((MOST + 2, 1.0), (1, PERIOD + 2.0)):
        for _ in range(count):
            refusals.add("unknown", "POST /", "here", "403")
    told = [entry.what for entry in audit.tail(3)]
    audit.close()
    assert told == ["POST /", "2 more requests", "POST /"]
