"""Threads for file operations, and responses with files of the data folder."""

import asyncio
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.testclient import TestClient

from tests.harness.root import ROOT
from web.api.files import FileThreads, stored_file


def test_a_disk_that_does_not_answer_leaves_the_threads_of_commands_free():
    answers = threading.Event()  # set: the disk answers

    async def requests() -> tuple[list[object], str, str]:
        files = FileThreads(4, patience=0.05)
        hung = [asyncio.create_task(files.run(answers.wait)) for _ in range(4)]
        refused = await asyncio.gather(*(files.run(lambda: "read") for _ in range(60)), return_exceptions=True)
        command = await asyncio.to_thread(lambda: "stopped")
        answers.set()
        await asyncio.gather(*hung)
        return list(refused), command, await files.run(lambda: "read")

    refused, command, read = asyncio.run(requests())
    assert {type(one) for one in refused} == {HTTPException}
    assert {one.status_code for one in refused if isinstance(one, HTTPException)} == {503}
    assert "the disk of the data folder does not answer" in str(refused[0])
    assert (command, read) == ("stopped", "read")


def test_the_end_of_the_program_does_not_wait_for_a_disk():
    program = """
import asyncio, threading
from web.api.files import FileThreads
async def main():
    task = asyncio.create_task(FileThreads().run(threading.Event().wait))
    await asyncio.sleep(0.1)
    task.cancel()
asyncio.run(main())
"""
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, timeout=300)


def test_the_error_of_a_file_operation_reaches_its_request():
    def fail() -> None:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        asyncio.run(FileThreads().run(fail))


CONTENT = bytes(range(256)) * 3000  # more than two chunks


@pytest.fixture
def client(tmp_path: Path) -> TestClient:
    (tmp_path / "file.bin").write_bytes(CONTENT)
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "link").symlink_to("file.bin")
    files = FileThreads()

    async def send(request: Request) -> Response:
        return await stored_file(files, tmp_path, request.path_params["name"], "application/octet-stream")

    return TestClient(Starlette(routes=[Route("/{name}", send)]))


@pytest.mark.parametrize(
    ("asked", "status", "start", "end"),
    [
        ("bytes=0-9", 206, 0, 10),
        ("bytes=700000-", 206, 700_000, len(CONTENT)),
        ("bytes=-7", 206, len(CONTENT) - 7, len(CONTENT)),
        ("bytes=5-99999999999999999999999", 206, 5, len(CONTENT)),
        ("bytes=0-", 200, 0, len(CONTENT)),
        ("bytes=9-3", 200, 0, len(CONTENT)),
        ("bytes=0-1,5-6", 200, 0, len(CONTENT)),
        ("bytes=-", 200, 0, len(CONTENT)),
        ("lines=1-2", 200, 0, len(CONTENT)),
    ],
)
def test_a_range_of_a_file_is_sent(client, asked, status, start, end):
    answer = client.get("/file.bin", headers={"range": asked})
    assert (answer.status_code, answer.content == CONTENT[start:end]) == (status, True)
    if status == 206:
        assert answer.headers["content-range"] == f"bytes {start}-{end - 1}/{len(CONTENT)}"


def test_a_range_beyond_the_end_is_refused(client):
    answer = client.get("/file.bin", headers={"range": f"bytes={len(CONTENT)}-"})
    assert (answer.status_code, answer.content) == (416, b"")
    assert answer.headers["content-range"] == f"bytes */{len(CONTENT)}"


def test_a_range_of_a_file_that_has_changed_is_not_sent(client):
    known = client.get("/file.bin").headers["etag"]
    for tag, status in ((known, 206), ('"other"', 200)):
        assert client.get("/file.bin", headers={"range": "bytes=1-2", "if-range": tag}).status_code == status


def test_an_empty_file_is_sent_and_a_link_or_a_missing_file_is_not(client):
    assert (client.get("/empty").status_code, client.get("/empty").content) == (200, b"")
    assert client.get("/link").status_code == 404
    assert client.get("/none").status_code == 404
