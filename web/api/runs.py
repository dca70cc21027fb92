"""REST routes of the recorded runs: list, notes, recordings, reports, replay and deletion."""

import asyncio
import shutil
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import FileResponse
from pydantic import ConfigDict, Field
from starlette.background import BackgroundTask
from starlette.exceptions import HTTPException

from station.config.strict import Row, Strict
from station.recording.history import (
    MAX_NOTES_CHARS,
    MAX_TAG_CHARS,
    MAX_TAGS,
    MAX_TITLE_CHARS,
    NoRunError,
    RunDetails,
    RunEntry,
    RunHistory,
    RunSettings,
)
from station.recording.run_folder import VIDEOS_FOLDER
from station.recording.run_outcome import RecordingError
from station.report.curves import Curve, read_curves
from web.api.commands import Commands, cancel_on_disconnect
from web.api.schemas import REFUSED_RESPONSES, ErrorOut

ExportFormat = Literal["csv", "parquet", "mat"]
NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such run or case"}}
MCAP_MEDIA_TYPE = "application/octet-stream"
#: Content-Security-Policy of a report or replay page. The page may load nothing, because the file is complete.
STANDALONE_POLICY = (
    "default-src 'none'; img-src data: blob:; media-src blob:; font-src data:; style-src 'unsafe-inline';"
    " script-src 'unsafe-inline';"
    " frame-ancestors 'self'"
)


Tag = Annotated[str, Field(min_length=1, max_length=MAX_TAG_CHARS)]


class NotesIn(Strict):
    """What the operator adds to a run; omitted fields stay as they are."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"notes": "New coil since this morning.", "tags": ["coil 2"], "starred": True}]}
    )

    notes: Annotated[str, Field(max_length=MAX_NOTES_CHARS)] | None = None
    title: Annotated[str, Field(max_length=MAX_TITLE_CHARS)] | None = None
    """empty: the recorded title"""
    starred: bool | None = None
    tags: Annotated[tuple[Tag, ...], Field(max_length=MAX_TAGS), Row] | None = None


class DeletedOut(Strict):
    """A run that was deleted; it can be restored for a day."""

    deleted: str


def runs_routes(history: RunHistory, of: Commands) -> APIRouter:
    """Return the REST routes under /api/runs."""
    router = APIRouter(
        prefix="/api/runs",
        tags=["runs"],
        dependencies=[Depends(of.renew_lease)],
        responses={422: REFUSED_RESPONSES[422]},
    )
    rendering = asyncio.Lock()

    @router.get("", summary="Runs, newest first")
    async def runs(
        experiment: str = "",
        label: str = "",
        text: Annotated[str, Query(description="text in name, title, cause, tags or notes")] = "",
        limit: Annotated[int, Query(ge=1, le=10_000)] = 1000,
        *,
        deleted: Annotated[bool, Query(description="list the deleted runs instead")] = False,
    ) -> list[RunEntry]:
        chosen = history.deleted() if deleted else history
        return list((await asyncio.to_thread(chosen.runs, experiment, label, text))[:limit])

    @router.get("/{run}", responses=NOT_FOUND, summary="One run; `latest` is the newest")
    async def one(run: str) -> RunDetails:
        return await _found(history.run, run)

    @router.get("/{run}/settings", responses=NOT_FOUND, summary="Settings of a recorded case, to run it again")
    async def settings(
        run: str, case: Annotated[str, Query(description="may be omitted if the run has only one case")] = ""
    ) -> RunSettings:
        return await _found(history.settings, run, case)

    @router.put("/{run}/notes", responses=NOT_FOUND, summary="Set notes, title, star or tags of a run")
    async def notes(run: str, body: NotesIn) -> RunDetails:
        return await _found(partial(history.annotate, **body.model_dump()), run)

    @router.get(
        "/{run}/export",
        response_class=FileResponse,
        responses=NOT_FOUND | {409: REFUSED_RESPONSES[409]},
        summary="Telemetry of a case for other programs",
    )
    async def export(request: Request, run: str, format: ExportFormat, case: str = "") -> FileResponse:  # noqa: A002
        recording = await _found(history.recording, run, case)
        out = Path(await asyncio.to_thread(tempfile.mkdtemp, prefix="ctr-export-"))
        remove = partial(shutil.rmtree, out, ignore_errors=True)

        async def write() -> None:
            async with rendering:
                await _command(
                    "export", recording.parent, "--case", recording.stem, "--format", format, "--out", str(out)
                )

        try:
            await cancel_on_disconnect(request, write())
        except BaseException:
            remove()
            raise
        name = f"{recording.parent.name}-{recording.stem}.{format}"
        return FileResponse(out / f"{recording.stem}.{format}", filename=name, background=BackgroundTask(remove))

    @router.get(
        "/{run}/recording",
        response_class=FileResponse,
        responses=NOT_FOUND
        | {200: {"content": {MCAP_MEDIA_TYPE: {}}, "description": "an MCAP file, which Foxglove can open"}},
        summary="Recording of a case",
    )
    async def recording(
        run: str, case: Annotated[str, Query(description="may be omitted if the run has only one case")] = ""
    ) -> FileResponse:
        path = await _found(history.recording, run, case)
        return FileResponse(path, media_type=MCAP_MEDIA_TYPE, filename=f"{path.parent.name}-{path.name}")

    @router.get(
        "/{run}/video",
        response_class=FileResponse,
        responses=NOT_FOUND
        | {200: {"content": {"video/mp4": {}}, "description": "an MP4 file"}, 409: REFUSED_RESPONSES[409]},
        summary="Video of a camera",
    )
    async def video(
        request: Request, run: str, camera: Annotated[str, Query(description="may be omitted: the first camera")] = ""
    ) -> FileResponse:
        details: RunDetails = await _found(history.run, run)
        name = camera or next(iter(details.videos), "")
        if name not in details.videos:
            names = ", ".join(details.videos) or "none"
            raise HTTPException(404, f"run '{details.id}' has no video '{camera}'; its videos are: {names}")
        folder: Path = await _found(history.find, details.id)
        path = folder / VIDEOS_FOLDER / f"{name}.mp4"

        async def write() -> None:
            async with rendering:
                if not path.is_file():
                    options = ("--format", "mp4", "--camera", name, "--out", str(path.parent.absolute()))
                    await _command("export", folder, *options)

        await cancel_on_disconnect(request, write())
        return FileResponse(path, filename=f"{folder.name}-{name}.mp4", media_type="video/mp4")

    @router.get(
        "/{run}/report",
        response_class=FileResponse,
        responses=NOT_FOUND,
        summary="Report of a run: figures and tables in a page",
    )
    async def report(request: Request, run: str, *, fresh: bool = False) -> FileResponse:
        return await _page(request, await _found(history.find, run), "report", fresh=fresh)

    @router.get("/{run}/replay", response_class=FileResponse, responses=NOT_FOUND, summary="Replay of a run as a page")
    async def replay(request: Request, run: str, *, fresh: bool = False) -> FileResponse:
        return await _page(request, await _found(history.find, run), "replay", fresh=fresh)

    @router.get(
        "/{run}/curves", responses=NOT_FOUND, summary="Error and force over time of each case, for a small plot"
    )
    async def curves(
        run: str,
        *,
        stored: Annotated[bool, Query(description="only the curves of an earlier request, else none; quick")] = False,
    ) -> dict[str, Curve]:
        folder = await _found(history.find, run)
        if stored:
            return dict(await asyncio.to_thread(read_curves, folder) or {})
        async with rendering:
            found = await asyncio.to_thread(read_curves, folder)
            if found is None:
                await _command("curves", folder)
                found = await asyncio.to_thread(read_curves, folder)
        return dict(found or {})

    @router.delete(
        "/{run}",
        responses=NOT_FOUND | REFUSED_RESPONSES,
        dependencies=[Depends(of.require_operator)],
        summary="Delete a run; it can be restored for a day",
    )
    async def delete(
        run: str, confirm: Annotated[str, Query(description="the run's name, as a confirmation")] = ""
    ) -> DeletedOut:
        await _found(history.delete, run, confirm)
        return DeletedOut(deleted=run)

    @router.post(
        "/{run}/restore",
        responses=NOT_FOUND | REFUSED_RESPONSES,
        dependencies=[Depends(of.require_operator)],
        summary="Restore a deleted run",
    )
    async def restore(run: str) -> RunDetails:
        return await _found(history.restore, run)

    async def _page(request: Request, folder: Path, command: str, *, fresh: bool) -> FileResponse:
        path = folder / f"{command}.html"

        async def render() -> None:
            async with rendering:  # one report at a time, because rendering uses a whole processor for seconds
                if fresh or not path.is_file():
                    await _command(command, folder)

        await cancel_on_disconnect(request, render())
        return FileResponse(path, headers={"content-security-policy": STANDALONE_POLICY, "cache-control": "no-cache"})

    return router


async def _found(function: Any, *arguments: Any) -> Any:
    try:
        return await asyncio.to_thread(function, *arguments)
    except NoRunError as error:
        raise HTTPException(404, str(error)) from None


async def _command(command: str, folder: Path, *options: str) -> None:
    """Run a command of `ctr-station` on a run in a separate process, to keep the station responsive."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "station", command, str(folder.absolute()), *options,
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        _, errors = await process.communicate()
    except asyncio.CancelledError:
        process.kill()
        await process.wait()
        raise
    if process.returncode:
        lines = errors.decode(errors="replace").strip().splitlines()
        reason = lines[-1] if lines else f"exit status {process.returncode}"
        raise RecordingError(f"the {command} of run '{folder.name}' failed: {reason}")
