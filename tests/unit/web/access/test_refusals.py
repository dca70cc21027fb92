"""For a flood of refused requests the audit log has some of the requests, their count, and every command."""

import asyncio
from pathlib import Path

from starlette.types import Message, Receive, Scope, Send

from station.service.audit import Audit
from web.access.audit_middleware import AuditMiddleware
from web.access.gate import Access
from web.access.refusals import MAX_WRITTEN, SUMMARY_INTERVAL_S, Refusals


async def _taken(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "http":
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})


async def _post(app: AuditMiddleware, path: str, origin: str = "http://127.0.0.1:8000") -> None:
    async def receive() -> Message:
        return {"type": "http.request", "body": b""}

    async def send(_message: Message) -> None:
        pass

    headers = [(b"host", b"127.0.0.1:8000"), (b"origin", origin.encode())]
    scope = {"type": "http", "method": "POST", "path": path, "client": ("127.0.0.1", 5), "headers": headers}
    await app(scope, receive, send)


def test_a_flood_of_refusals_is_counted_and_pushes_no_command_out_of_the_log(tmp_path: Path) -> None:
    audit = Audit(tmp_path, limit=20_000)
    app = AuditMiddleware(Access(_taken, "127.0.0.1", 8000, None), audit)

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
    assert sum("evil.example" in entry.outcome for entry in told) == MAX_WRITTEN
    assert [(entry.what, entry.where) for entry in told if entry.who == "several"] == [
        (f"{3000 - MAX_WRITTEN} more requests", "127.0.0.1")
    ]


def test_the_refusal_log_of_a_new_minute_starts_with_the_count_of_the_last_one(tmp_path: Path) -> None:
    audit, times = Audit(tmp_path), [0.0]
    refusals = Refusals(audit, lambda: times[0])
    for count, times[0] in ((MAX_WRITTEN + 2, 1.0), (1, SUMMARY_INTERVAL_S + 2.0)):
        for _ in range(count):
            refusals.add("unknown", "POST /", "here", "403")
    told = [entry.what for entry in audit.tail(3)]
    audit.close()
    assert told == ["POST /", "2 more requests", "POST /"]
