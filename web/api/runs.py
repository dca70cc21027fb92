"""Run history over REST: list, notes, recordings, reports, replay, removal."""

import asyncio
import sys
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import FileResponse
from pydantic import ConfigDict, Field
from starlette.exceptions import HTTPException

from station.config.strict import Strict
from station.recording.history import LONGEST, History, NoRunError, Run, RunDetails
from station.recording.label import RecordingError
from station.report.curves import Curve, read_curves
from web.api.commands import Commands, aside
from web.api.schemas import REFUSED, ErrorOut
from web.api.wanted import while_wanted

MISSING: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such run or case"}}
MCAP = "application/octet-stream"
#: What a page made of a recording may do: show itself. It carries all that it needs.
STANDS_ALONE = (
    "default-src 'none'; img-src data: blob:; font-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline';"
    " frame-ancestors 'self'"
)


class NotesIn(Strict):
    """What a person has to say about a run."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"notes": "New coil since this morning."}]})

    notes: Annotated[str, Field(max_length=LONGEST)]


class DeletedOut(Strict):
    """A run that is no more."""

    deleted: str


def runs_routes(history: History, of: Commands) -> APIRouter:
    """Routes under /api/runs."""
    router = APIRouter(
        prefix="/api/runs", tags=["runs"], dependencies=[Depends(of.heard)], responses={422: REFUSED[422]}
    )
    rendering = asyncio.Lock()

    @router.get("", summary="Runs, newest first")
    async def runs(
        experiment: str = "",
        label: str = "",
        text: Annotated[str, Query(description="in name, title, cause or notes")] = "",
        limit: Annotated[int, Query(ge=1, le=10_000)] = 1000,
    ) -> list[Run]:
        return list((await aside(history.runs, experiment, label, text))[:limit])

    @router.get("/{run}", responses=MISSING, summary="One run; `latest` is the newest")
    async def one(run: str) -> RunDetails:
        return await _found(history.run, run)

    @router.put("/{run}/notes", responses=MISSING, summary="Write down something about a run")
    async def notes(run: str, wish: NotesIn) -> RunDetails:
        return await _found(history.set_notes, run, wish.notes)

    @router.get(
        "/{run}/recording",
        response_class=FileResponse,
        responses=MISSING | {200: {"content": {MCAP: {}}, "description": "an MCAP file, as Foxglove opens it"}},
        summary="The recording of a case",
    )
    async def recording(
        run: str, case: Annotated[str, Query(description="may be left out when there is one only")] = ""
    ) -> FileResponse:
        path = await _found(history.recording, run, case)
        return FileResponse(path, media_type=MCAP, filename=f"{path.parent.name}-{path.name}")

    @router.get(
        "/{run}/report", response_class=FileResponse, responses=MISSING, summary="Figures and tables, as a page"
    )
    async def report(request: Request, run: str, *, fresh: bool = False) -> FileResponse:
        return await _page(request, await _found(history.find, run), "report", fresh=fresh)

    @router.get(
        "/{run}/replay", response_class=FileResponse, responses=MISSING, summary="The run as a page that plays it"
    )
    async def replay(request: Request, run: str, *, fresh: bool = False) -> FileResponse:
        return await _page(request, await _found(history.find, run), "replay", fresh=fresh)

    @router.get("/{run}/curves", responses=MISSING, summary="Error and force of each case, for a small picture")
    async def curves(run: str) -> dict[str, Curve]:
        folder = await _found(history.find, run)
        async with rendering:
            found = await aside(read_curves, folder)
            if found is None:
                await _rendered("curves", folder)
                found = await aside(read_curves, folder)
        return dict(found or {})

    @router.delete("/{run}", responses=MISSING | REFUSED, dependencies=[Depends(of.needed)], summary="Remove for good")
    async def delete(run: str, confirm: Annotated[str, Query(description="the run's name again")] = "") -> DeletedOut:
        await _found(history.delete, run, confirm)
        return DeletedOut(deleted=run)

    async def _page(request: Request, folder: Path, command: str, *, fresh: bool) -> FileResponse:
        path = folder / f"{command}.html"

        async def made() -> None:
            async with rendering:  # one at a time: each takes a processor for seconds
                if fresh or not path.is_file():
                    await _rendered(command, folder)

        await while_wanted(request, made())
        return FileResponse(path, headers={"content-security-policy": STANDS_ALONE, "cache-control": "no-cache"})

    return router


async def _found(function: Any, *arguments: Any) -> Any:
    try:
        return await aside(function, *arguments)
    except NoRunError as error:
        raise HTTPException(404, str(error)) from None


async def _rendered(command: str, folder: Path) -> None:
    """Carry out `ctr-station report` or `replay` in a process of its own: the station has other things to do."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "station", command, str(folder.absolute()),
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        _, said = await process.communicate()
    except asyncio.CancelledError:
        process.kill()
        await process.wait()
        raise
    if process.returncode:
        lines = said.decode(errors="replace").strip().splitlines()
        raise RecordingError(f"no {command} of run '{folder.name}': {lines[-1] if lines else process.returncode}")
