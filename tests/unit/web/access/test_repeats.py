"""The audit log keeps every command, however many STOPs follow; STOP is accepted from any client at any rate."""

import asyncio
from collections.abc import Callable
from pathlib import Path

from starlette.types import Message, Receive, Scope, Send

from station.service.audit import Audit
from web.access.audit_middleware import REPEAT_INTERVAL_S, AuditMiddleware
from web.access.gate import Access
from web.access.repeats import MAX_LINES, MAX_SENDERS, PERIOD_S, Repeats


async def _accepted(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "http":
        await receive()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})


async def _post(app: AuditMiddleware, path: str, body: bytes, name: str = "") -> None:
    async def receive() -> Message:
        return {"type": "http.request", "body": body}

    async def send(_message: Message) -> None:
        pass

    headers = [(b"host", b"127.0.0.1:8000"), (b"x-ctr-name", name.encode())]
    scope = {"type": "http", "method": "POST", "path": path, "client": ("127.0.0.1", 5), "headers": headers}
    await app(scope, receive, send)


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
