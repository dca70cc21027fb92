"""The audit log keeps every command; a flood of refused requests or of STOPs is logged as some lines and a count."""

import asyncio
from collections.abc import Callable
from pathlib import Path

from starlette.types import Message, Receive, Scope, Send

from station.service.audit import Audit
from web.access.audit_middleware import (
    MAX_LINES,
    MAX_SENDERS,
    MAX_WRITTEN,
    PERIOD_S,
    REPEAT_INTERVAL_S,
    SUMMARY_INTERVAL_S,
    AuditMiddleware,
    Refusals,
    Repeats,
)
from web.access.gate import Access


async def _accepted(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "http":
        await receive()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})


async def _post(
    app: AuditMiddleware, path: str, body: bytes = b"", name: str = "", origin: str = "http://127.0.0.1:8000"
) -> None:
    async def receive() -> Message:
        return {"type": "http.request", "body": body}

    async def send(_message: Message) -> None:
        pass

    headers = [(b"host", b"127.0.0.1:8000"), (b"x-ctr-name", name.encode()), (b"origin", origin.encode())]
    scope = {"type": "http", "method": "POST", "path": path, "client": ("127.0.0.1", 5), "headers": headers}
    await app(scope, receive, send)


def test_a_flood_of_refusals_is_counted_and_pushes_no_command_out_of_the_log(tmp_path: Path) -> None:
    audit = Audit(tmp_path, limit=20_000)
    app = AuditMiddleware(Access(_accepted, "127.0.0.1", 8000, None), audit)

    async def flood() -> None:
        await _post(app, "/api/start")
        for number in range(3000):
            await _post(app, "/api/start", origin=f"http://{number}.evil.example")
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


def flooded(folder: Path, name: Callable[[int], str]) -> Audit:
    """Return the audit log after a command and very many STOPs with long bodies."""
    audit = Audit(folder, limit=20_000)
    app = AuditMiddleware(Access(_accepted, "127.0.0.1", 8000, None), audit)

    async def flood() -> None:
        await _post(app, "/api/start", b"{}")
        for number in range(3000):
            await _post(app, "/api/stop", 400 * b"x", name(number))
        await app({"type": "lifespan"}, None, None)  # type: ignore[arg-type]

    asyncio.run(flood())
    return audit


def test_a_flood_of_accepted_stops_pushes_no_command_out_of_the_log(tmp_path: Path) -> None:
    audit = flooded(tmp_path, lambda _: "a viewer")
    entries = audit.tail(1000)
    audit.close()
    assert [entry.what for entry in entries] == ["POST /api/stop", "POST /api/stop", "POST /api/start {}"]
    assert entries[0].outcome.startswith("repeated 2999 times, first ")
    assert entries[0].who.startswith("a viewer")
    assert entries[1].outcome == "200"


def test_a_sender_with_changing_names_pushes_no_command_out_of_the_log(tmp_path: Path) -> None:
    audit = flooded(tmp_path, lambda number: f"viewer {number}")
    entries = audit.tail(1000)
    audit.close()
    assert [entry.outcome for entry in entries].count("200") == MAX_LINES + 1
    assert entries[-1].what == "POST /api/start {}"
    assert entries[0].who == "several (operator)"
    assert entries[0].outcome.startswith(f"repeated {3000 - MAX_LINES} times, first ")


def test_repeated_stops_are_counted_by_address_and_logged_after_a_minute(tmp_path: Path) -> None:
    audit, times = Audit(tmp_path), [0.0]
    repeats = Repeats(audit, lambda: times[0])
    for where in ("here", "there", "here", "here"):
        repeats.add("one", "viewer", "POST /api/stop", where, "200")
    times[0] = PERIOD_S
    repeats.sum_up()
    entries = audit.tail(10)
    audit.close()
    assert sorted(entry.where for entry in entries) == ["here", "here", "there"]
    assert [entry.outcome[:16] for entry in entries if not entry.outcome.startswith("200")] == ["repeated 2 times"]


def test_stops_from_many_addresses_are_counted_together_as_several(tmp_path: Path) -> None:
    audit = Audit(tmp_path)
    repeats = Repeats(audit, lambda: 0.0)
    for number in range(1000):
        repeats.add(f"viewer {number}", "viewer", "POST /api/stop", f"2001:db8::{number:x}", "200")
    repeats.sum_up(now=True)
    entries = audit.tail(1000)
    audit.close()
    assert len(entries) == MAX_SENDERS + MAX_LINES + 1
    assert entries[0].where == "several"
    assert entries[0].outcome.startswith(f"repeated {1000 - MAX_SENDERS - MAX_LINES} times")


def test_a_jog_that_is_repeated_within_the_interval_has_one_line_of_the_log(tmp_path: Path) -> None:
    audit, times = Audit(tmp_path), [0.0]
    app = AuditMiddleware(Access(_accepted, "127.0.0.1", 8000, None), audit, lambda: times[0])

    async def jog() -> None:
        for pause in (0.0, 0.9, 0.9, 1.1, 0.9):
            times[0] += pause * REPEAT_INTERVAL_S
            await _post(app, "/api/jog", b"{}")

    asyncio.run(jog())
    entries = audit.tail(10)
    audit.close()
    assert [entry.what for entry in entries] == 2 * ["POST /api/jog {}"]
