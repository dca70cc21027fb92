"""Requests to the history of runs in folders with links, FIFOs, devices, sockets and folders in place of files.

A request is never answered with 5xx, waits for no FIFO, and reads and removes nothing outside the folder of the runs.
A recording is never lost, and a change that was accepted is read back.
"""

import json
import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from fastapi import FastAPI, Request
from hypothesis import given, settings
from hypothesis import strategies as st
from starlette.testclient import TestClient

from station.recording.deletion import deletion_now
from station.recording.history import RunHistory
from station.recording.recover import recover
from station.recording.run_folder import MARK_FILE, MARK_TEXT
from tests.harness.runs_server import NO_COMMAND
from web.access.identity import Role, Sender
from web.access.lease import Lease
from web.api.commands import commands
from web.api.files import FileThreads
from web.api.refusals import answer_errors
from web.api.runs import runs_routes

SECRET = "content of another file of the computer"
RECORDING = b"\x89MCAP0\r\n damaged, but the only one"
#: Content of a file of the user, in a folder whose name is like that of an unfinished run.
THESIS = b"the only copy"
OLD = deletion_now("old").model_copy(update={"time": 1.0, "since_boot": -1e9}).model_dump()
#: Paths in the folder of runs, each with its usual content.
USUAL = {
    "run/summary.json": json.dumps({"title": "a run", "started": 5.0, "cases": {"run": {"completed": True}}}),
    "run/notes.json": json.dumps({"notes": "new coil", "starred": True}),
    "run/run.mcap": RECORDING,
    "run/experiment.toml": 'title = "x"\n',
    "run/report.html": "<p>report</p>",
    "run/replay.html": "<p>replay</p>",
    "run/curves.json": "{}",
    "run/deleted.json": json.dumps(OLD),
    "run/cameras/one.mcap": "video",
    "run/cameras/one.mp4": "video",
    "run/cameras": None,
    "other/sweep.json": "{}",
    "broken.partial/run.mcap.partial": b"\x89MCAP0\r\n",
    f"broken.partial/{MARK_FILE}": MARK_TEXT,
    "broken.partial": None,
    "thesis.partial/thesis.txt": THESIS,
    "thesis.partial/run.mcap.partial": b"\x89MCAP0\r\n",
    "thesis.partial/summary.json": "{}",
    "deleted": None,
    "deleted/old": None,
    "deleted/old/summary.json": "{}",
    "deleted/old/deleted.json": json.dumps(OLD),
    "deleted/run": None,
}
KINDS = ("file", "link", "folder link", "loop", "folder", "FIFO", "device", "socket", "unreadable", "locked", "damaged")


def put(path: Path, kind: str, outside: Path) -> None:
    """Create something of a kind at a path, in place of what is there."""
    if any(parent.is_symlink() or (parent.exists() and not parent.is_dir()) for parent in path.parents):
        return  # this path would be outside
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "link":
        path.symlink_to(outside / "secret.json")
    elif kind == "folder link":
        path.symlink_to(outside / "run")
    elif kind == "loop":
        path.symlink_to(path.name)
    elif kind == "folder":
        path.mkdir()
    elif kind == "FIFO":
        os.mkfifo(path)
    elif kind == "device":
        os.mknod(path, 0o20666, os.makedev(1, 5))  # /dev/zero, which never ends
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as listening:
            listening.bind(str(path))
    elif kind == "damaged":
        path.write_bytes(b"\xff{[")
    else:
        path.write_text("{}")
        path.chmod(0o000 if kind == "unreadable" else 0o644)


class Place(NamedTuple):
    """A folder of runs with its usual content, a folder outside of it, and a client of its history."""

    runs: Path
    outside: Path
    client: TestClient

    def fill(self) -> None:
        """Create the usual content again."""
        for folder in (self.runs, self.outside):
            shutil.rmtree(folder, ignore_errors=True)
        for path, content in USUAL.items():
            if content is None:
                (self.runs / path).mkdir(parents=True, exist_ok=True)
            else:
                (self.runs / path).parent.mkdir(parents=True, exist_ok=True)
                (self.runs / path).write_bytes(content.encode() if isinstance(content, str) else content)
        shutil.rmtree(self.runs / "deleted" / "run")
        (self.outside / "run").mkdir(parents=True)
        for name in ("secret.json", "run/summary.json", "run/run.mcap", "run/one.mcap", "run/run.mcap.partial"):
            (self.outside / name).write_text(json.dumps({"title": SECRET}))
        (self.outside / "run" / "deleted.json").write_text(json.dumps({**OLD, "run": "run"}))


@pytest.fixture(scope="module")
def place() -> Iterator[Place]:
    with tempfile.TemporaryDirectory(prefix="r") as name:  # the path of a socket has at most 107 bytes
        runs = Path(name, "runs")
        app = FastAPI()
        app.include_router(runs_routes(RunHistory(runs), commands(Lease()), FileThreads()))
        answer_errors(app)

        @app.middleware("http")
        async def known(request: Request, call_next: Any) -> Any:
            state = request.scope.setdefault("state", {})
            state["who"], state["permit"] = Sender(Role.OPERATOR, "anna", "Anna", "127.0.0.1"), NO_COMMAND
            return await call_next(request)

        with TestClient(app) as client:
            yield Place(runs, Path(name, "outside"), client)


def contents(folder: Path) -> dict[str, bytes]:
    """Return the regular files of a folder with their contents."""
    found = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def kept(runs: Path) -> tuple[int, int]:
    """Return the number of copies of the recording and of the user's file."""
    found = list(contents(runs).values())
    return found.count(RECORDING), found.count(THESIS)


REQUESTS = (
    ("GET", ""), ("GET", "?deleted=true"), ("GET", "?text=secret"), ("GET", "/run"), ("GET", "/latest"),
    ("GET", "/run/settings"), ("GET", "/run/recording"), ("GET", "/run/curves?stored=true"), ("GET", "/other"),
    ("DELETE", "/run?confirm=run"), ("DELETE", "/other?confirm=other"), ("POST", "/run/restore"),
    ("POST", "/old/restore"), ("PUT", "/run/notes"), ("PUT", "/other/notes"),
)  # fmt: skip
odd_paths = st.dictionaries(st.sampled_from(sorted(USUAL)), st.sampled_from(KINDS), min_size=1, max_size=5)


@settings(max_examples=int(os.environ.get("ODD_FOLDERS", "40")))
@given(odd=odd_paths, requests=st.lists(st.sampled_from(REQUESTS), min_size=1, max_size=8), note=st.text(max_size=5))
def test_requests_to_odd_folders_of_runs_are_answered_and_touch_nothing_outside(place, odd, requests, note):
    place.fill()
    runs, outside, client = place
    for path, kind in sorted(odd.items()):
        try:
            put(runs / path, kind, outside)
        except PermissionError:
            put(runs / path, "FIFO", outside)  # only root may create a device
    before, recorded = contents(outside), kept(runs)
    for method, path in requests:
        body = {"notes": note, "starred": True} if method == "PUT" else None
        answer = client.request(method, f"/api/runs{path}", json=body)
        assert answer.status_code < 500, answer.text
        assert SECRET not in answer.text
        if method == "PUT" and answer.status_code == 200:
            assert client.get(f"/api/runs{path.removesuffix('/notes')}").json()["notes"] == note
    recover(runs)
    RunHistory(runs).purge()
    assert contents(outside) == before
    # A run is removed only if its deletion is recorded and old.
    assert kept(runs) == recorded


@pytest.mark.parametrize(
    ("file", "path", "kind"),
    [
        ("report.html", "/run/report", "link"), ("report.html", "/run/report", "FIFO"),
        ("replay.html", "/run/replay", "device"), ("cameras/one.mp4", "/run/video", "link"),
    ],
)  # fmt: skip
def test_an_odd_page_or_video_is_not_sent(place, kind, file, path):
    place.fill()
    try:
        put(place.runs / "run" / file, kind, place.outside)
    except PermissionError:
        pytest.skip("only root may create a device")
    before = contents(place.outside)
    answer = place.client.get(f"/api/runs{path}")
    assert answer.status_code == 422, answer.text  # the recording and the video are damaged
    assert SECRET not in answer.text
    assert contents(place.outside) == before


@pytest.mark.parametrize("kind", ["link", "folder link", "folder", "FIFO", "device", "socket"])
def test_an_odd_recording_is_not_sent(place, kind):
    place.fill()
    runs, outside, client = place
    try:
        put(runs / "run" / "run.mcap", kind, outside)
    except PermissionError:
        pytest.skip("only root may create a device")
    for path in ("/run/recording", "/run/settings"):
        answer = client.get(f"/api/runs{path}")
        assert answer.status_code == 404, answer.text
        assert "no recording" in answer.json()["error"]
