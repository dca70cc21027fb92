"""REST routes of the recorded runs: list, notes, recordings, reports, replay and deletion."""

import asyncio
import sys
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import FileResponse
from pydantic import ConfigDict, Field
from starlette.exceptions import HTTPException

from station.config.strict import Strict
from station.recording.history import MAX_NOTES_CHARS, NoRunError, RunDetails, RunEntry, RunHistory
from station.recording.run_outcome import RecordingError
from station.report.curves import Curve, read_curves
from web.api.commands import Commands, cancel_on_disconnect
from web.api.schemas import REFUSED_RESPONSES, ErrorOut

NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such run or case"}}
MCAP_MEDIA_TYPE = "application/octet-stream"
#: Content-Security-Policy of a report or replay page. The page may load nothing, because the file is complete.
STANDALONE_POLICY = (
    "default-src 'none'; img-src data: blob:; font-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline';"
    " frame-ancestors 'self'"
)


class NotesIn(Strict):
    """The operator's notes on a run."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"notes": "New coil since this morning."}]})

    notes: Annotated[str, Field(max_length=MAX_NOTES_CHARS)]


class DeletedOut(Strict):
    """A run that was deleted."""

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
        text: Annotated[str, Query(description="text in name, title, cause or notes")] = "",
        limit: Annotated[int, Query(ge=1, le=10_000)] = 1000,
    ) -> list[RunEntry]:
        return list((await asyncio.to_thread(history.runs, experiment, label, text))[:limit])

    @router.get("/{run}", responses=NOT_FOUND, summary="One run; `latest` is the newest")
    async def one(run: str) -> RunDetails:
        return await _found(history.run, run)

    @router.put("/{run}/notes", responses=NOT_FOUND, summary="Set the notes of a run")
    async def notes(run: str, body: NotesIn) -> RunDetails:
        return await _found(history.set_notes, run, body.notes)

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
    async def curves(run: str) -> dict[str, Curve]:
        folder = await _found(history.find, run)
        async with rendering:
            found = await asyncio.to_thread(read_curves, folder)
            if found is None:
                await _rendered("curves", folder)
                found = await asyncio.to_thread(read_curves, folder)
        return dict(found or {})

    @router.delete(
        "/{run}",
        responses=NOT_FOUND | REFUSED_RESPONSES,
        dependencies=[Depends(of.require_operator)],
        summary="Delete a run permanently",
    )
    async def delete(
        run: str, confirm: Annotated[str, Query(description="the run's name, as a confirmation")] = ""
    ) -> DeletedOut:
        await _found(history.delete, run, confirm)
        return DeletedOut(deleted=run)

    async def _page(request: Request, folder: Path, command: str, *, fresh: bool) -> FileResponse:
        path = folder / f"{command}.html"

        async def render() -> None:
            async with rendering:  # one report at a time, because rendering uses a whole processor for seconds
                if fresh or not path.is_file():
                    await _rendered(command, folder)

        await cancel_on_disconnect(request, render())
        return FileResponse(path, headers={"content-security-policy": STANDALONE_POLICY, "cache-control": "no-cache"})

    return router


async def _found(function: Any, *arguments: Any) -> Any:
    try:
        return await asyncio.to_thread(function, *arguments)
    except NoRunError as error:
        raise HTTPException(404, str(error)) from None


async def _rendered(command: str, folder: Path) -> None:
    """Run `ctr-station report` or `replay` in a separate process, to keep the station responsive."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "station", command, str(folder.absolute()),
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
