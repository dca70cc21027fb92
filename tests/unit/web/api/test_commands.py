"""The rendering of a report is cancelled when its client disconnects."""

import asyncio
from pathlib import Path

import psutil
import pytest
from fastapi import FastAPI
from starlette.types import Message, Scope

from station.recording.history import RunHistory
from tests.harness.children import children
from web.access.identity import Role, Sender
from web.access.lease import Lease
from web.api.commands import commands
from web.api.files import FileThreads
from web.api.runs import runs_routes

SOMEBODY = Sender(Role.OPERATOR, "somebody", "Somebody", "127.0.0.1")


def _drawing() -> list[psutil.Process]:
    """Return the processes that render a report."""
    return children(word="report")


async def _ask(app: FastAPI, path: str, leaves: asyncio.Event) -> list[Message]:
    """Return the answer to a client that disconnects when `leaves` is set."""
    answers: list[Message] = []
    asked = False

    async def receive() -> Message:
        nonlocal asked
        if not asked:
            asked = True
            return {"type": "http.request", "body": b""}
        await leaves.wait()
        return {"type": "http.disconnect"}

    async def send(message: Message) -> None:
        answers.append(message)

    scope: Scope = {
        "type": "http", "method": "GET", "path": path, "query_string": b"", "headers": [], "state": {"who": SOMEBODY},
    }  # fmt: skip
    await app(scope, receive, send)
    return answers


@pytest.fixture
def app(tmp_path: Path) -> FastAPI:
    """Return an application with the history of one run, `mine`."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "summary.json").write_text("{}")
    app = FastAPI()
    app.include_router(runs_routes(RunHistory(tmp_path), commands(Lease()), FileThreads()))
    return app


def test_reports_of_disconnected_clients_are_not_rendered(app: FastAPI, tmp_path: Path) -> None:
    async def leave() -> list[list[Message]]:
        leaves = asyncio.Event()
        asking = [asyncio.create_task(_ask(app, "/api/runs/mine/report", leaves)) for _ in range(3)]
        while not _drawing():
            await asyncio.sleep(0.01)
        leaves.set()
        return await asyncio.gather(*asking)

    answers = asyncio.run(leave())

    assert [answer[0]["status"] for answer in answers] == [499] * 3
    assert not _drawing()
    assert not (tmp_path / "mine" / "report.html").exists()
