"""REST routes of the recorded runs: list, notes, recordings, reports, replay and deletion."""

import asyncio
import contextlib
import shutil
import sys
import tempfile
from collections.abc import Mapping
from functools import partial
from mimetypes import guess_type
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import FileResponse, Response
from pydantic import ConfigDict, Field
from starlette.background import BackgroundTask
from starlette.exceptions import HTTPException

from station.config.strict import Line, Row, Strict
from station.control.telemetry import FIELDS
from station.recording.export import TICK_RATE_HZ, fields_of
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
from station.recording.read import open_case
from station.recording.run_folder import VIDEOS_FOLDER
from station.recording.run_outcome import RecordingError
from station.regular_file import is_regular
from station.report.curves import Curve, read_curves
from web.api.commands import Commands, cancel_on_disconnect
from web.api.files import FILES_BUSY, FileThreads, stored_file
from web.api.schemas import REFUSED_RESPONSES, ErrorOut

FigureFormat = Literal["pdf", "svg"]
ExportFormat = Literal["csv", "parquet", "mat"]
NOT_FOUND: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such run or case"}}
MCAP_MEDIA_TYPE = "application/octet-stream"
#: Time to wait for the end of a killed command [s].
KILL_TIMEOUT_S = 2.0
#: Largest number of requests that write a file for a client, or wait to write one.
MAX_EXPORTS = 3
#: Content-Security-Policy of a report or replay page. The page may load nothing, because the file is complete.
STANDALONE_POLICY = (
    "default-src 'none'; img-src data: blob:; media-src blob:; font-src data:; style-src 'unsafe-inline';"
    " script-src 'unsafe-inline';"
    " frame-ancestors 'self'"
)


#: Meaning of each field of telemetry, by its name.
MEANINGS = {field.name: field.meaning for field in FIELDS}


Tag = Annotated[Line, Field(min_length=1, max_length=MAX_TAG_CHARS)]


class NotesIn(Strict):
    """Notes, title, star and tags of a run; omitted fields stay as they are."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"notes": "New coil since this morning.", "tags": ["coil 2"], "starred": True}]}
    )

    notes: Annotated[str, Field(max_length=MAX_NOTES_CHARS)] | None = None
    title: Annotated[Line, Field(max_length=MAX_TITLE_CHARS)] | None = None
    """title of the run; empty: the recorded title"""
    starred: bool | None = None
    tags: Annotated[tuple[Tag, ...], Field(max_length=MAX_TAGS), Row] | None = None


class FieldOut(Strict):
    """A field of a recording."""

    columns: int
    """number of columns of the field"""
    meaning: str
    """meaning of the field; empty: the recording is of another version"""


class ChannelsOut(Strict):
    """Telemetry fields that a case has recorded."""

    ticks: int
    """number of rows, 500 in a second"""
    fields: Mapping[str, FieldOut]
    """fields by name, in the order of the columns"""


class DeletedOut(Strict):
    """A run that was deleted; it can be restored for a day."""

    deleted: str


class Exports:
    """Limits the files that are written for clients: one at a time, and few requests may wait for it.

    Each waiting request occupies one of the six connections that a browser opens to a station.
    """

    def __init__(self, processor: asyncio.Lock, most: int = MAX_EXPORTS) -> None:
        """`processor` is locked while a file is written, because this uses a whole processor for seconds."""
        self._processor, self._most, self._requests = processor, most, 0

    async def __aenter__(self) -> None:
        """Wait until this file may be written.

        Raises:
            HTTPException: status 503: too many requests wait already.
        """
        if self._requests >= self._most:
            raise HTTPException(503, f"{self._most} files are being written; try again when one of them is complete")
        self._requests += 1
        try:
            await self._processor.acquire()
        except BaseException:
            self._requests -= 1
            raise

    async def __aexit__(self, *_: object) -> None:
        """Let the next file be written."""
        self._requests -= 1
        self._processor.release()


def runs_routes(history: RunHistory, of: Commands, files: FileThreads) -> APIRouter:
    """Return the REST routes under /api/runs. All accesses to the folder of runs use `files`."""
    router = APIRouter(
        prefix="/api/runs",
        tags=["runs"],
        dependencies=[Depends(of.renew_lease)],
        responses={422: REFUSED_RESPONSES[422], **FILES_BUSY},
    )
    found, rendering = partial(_found, files), asyncio.Lock()
    exports = Exports(rendering)

    @router.get("", summary="Runs, newest first")
    async def runs(
        experiment: str = "",
        label: str = "",
        text: Annotated[str, Query(description="text in name, title, cause, tags or notes")] = "",
        limit: Annotated[int, Query(ge=1, le=10_000)] = 1000,
        *,
        deleted: Annotated[bool, Query(description="list the deleted runs instead")] = False,
    ) -> list[RunEntry]:
        """List the runs that match all filters; `deleted` lists runs that can still be restored."""
        chosen = history.deleted() if deleted else history
        return list((await files.run(chosen.runs, experiment, label, text))[:limit])

    @router.get("/{run}", responses=NOT_FOUND, summary="One run; `latest` is the newest")
    async def one(run: str) -> RunDetails:
        """Return settings, errors of each case, notes and files of a run."""
        return await found(history.run, run)

    @router.get("/{run}/settings", responses=NOT_FOUND, summary="Settings of a recorded case, to run it again")
    async def settings(
        run: str, case: Annotated[str, Query(description="may be omitted if the run has only one case")] = ""
    ) -> RunSettings:
        """Return the settings of a recorded case in the form of a start request."""
        return await found(history.settings, run, case)

    @router.put("/{run}/notes", responses=NOT_FOUND, summary="Set notes, title, star or tags of a run")
    async def notes(run: str, body: NotesIn) -> RunDetails:
        """Save notes, title, star or tags at once, even while another client views the run."""
        return await found(partial(history.annotate, **body.model_dump()), run)

    @router.get("/{run}/channels", responses=NOT_FOUND, summary="Telemetry fields of a case, to choose an export")
    async def channels(run: str, case: str = "") -> ChannelsOut:
        """Return the number of rows, and the columns and meaning of each field that an export can include."""
        return await files.run(_channels, await found(history.recording, run, case))

    @router.get(
        "/{run}/export",
        response_class=FileResponse,
        responses=NOT_FOUND | {409: REFUSED_RESPONSES[409]},
        summary="Telemetry of a case for other programs",
    )
    async def export(
        request: Request,
        run: str,
        format: ExportFormat,  # noqa: A002
        case: str = "",
        fields: Annotated[
            str, Query(description="names of fields separated by commas, as `tip_measured,force`; empty: all")
        ] = "",
        rate: Annotated[float, Query(ge=0.1, le=TICK_RATE_HZ, description="rows in a second [1/s]")] = TICK_RATE_HZ,
    ) -> Response:
        """Return telemetry as CSV, Parquet or MATLAB file; fewer fields and a lower rate make a smaller file."""
        path = await found(history.recording, run, case)
        name, folder = f"{path.parent.name}-{path.stem}.{format}", str(path.parent.absolute())
        chosen = ("--case", path.stem, "--format", format, f"--fields={fields}", "--rate", str(rate))
        return await _written(request, name, "export", folder, *chosen, "--out")

    @router.get(
        "/{run}/figure",
        response_class=FileResponse,
        responses=NOT_FOUND | {409: REFUSED_RESPONSES[409]},
        summary="Tip error and force of two cases in one figure",
    )
    async def figure(
        request: Request,
        run: str,
        other: Annotated[str, Query(description="the other run, which may be the same")],
        format: FigureFormat,  # noqa: A002
        case: str = "",
        other_case: str = "",
    ) -> Response:
        """Return a vector figure for a journal's column of 88 mm; the case may be omitted if a run has only one."""
        both = [await found(history.recording, run, case), await found(history.recording, other, other_case)]
        names = [f"{path.parent.absolute()}:{path.stem}" for path in both]
        return await _written(
            request, f"{both[0].parent.name}-{both[0].stem}-overlay.{format}", "figure", *names, "--out"
        )

    @router.get(
        "/{run}/recording",
        response_class=FileResponse,
        responses=NOT_FOUND
        | {200: {"content": {MCAP_MEDIA_TYPE: {}}, "description": "an MCAP file, which Foxglove can open"}},
        summary="Recording of a case",
    )
    async def recording(
        run: str, case: Annotated[str, Query(description="may be omitted if the run has only one case")] = ""
    ) -> Response:
        """Return an MCAP file with every channel at 500 Hz, which Foxglove can open."""
        path = await found(history.recording, run, case)
        name = f"{path.parent.name}-{path.name}"
        return await stored_file(files, path.parent, path.name, MCAP_MEDIA_TYPE, attachment=name)

    @router.get(
        "/{run}/video",
        response_class=FileResponse,
        responses=NOT_FOUND
        | {200: {"content": {"video/mp4": {}}, "description": "an MP4 file"}, 409: REFUSED_RESPONSES[409]},
        summary="Video of a camera",
    )
    async def video(
        request: Request, run: str, camera: Annotated[str, Query(description="may be omitted: the first camera")] = ""
    ) -> Response:
        """Return a camera's video as MP4 file; the details of the run name its cameras."""
        details: RunDetails = await found(history.run, run)
        name = camera or next(iter(details.videos), "")
        if name not in details.videos:
            names = ", ".join(details.videos) or "none"
            raise HTTPException(404, f"run '{details.id}' has no video '{camera}'; its videos are: {names}")
        folder: Path = await found(history.find, details.id)
        path = folder / VIDEOS_FOLDER / f"{name}.mp4"

        async def write() -> None:
            async with rendering:
                if not await files.run(is_regular, path):
                    options = ("--format", "mp4", "--camera", name, "--out", str(path.parent.absolute()))
                    await _command("export", folder, *options)

        await cancel_on_disconnect(request, write())
        return await stored_file(files, path.parent, path.name, "video/mp4", attachment=f"{folder.name}-{name}.mp4")

    @router.get(
        "/{run}/report",
        response_class=FileResponse,
        responses=NOT_FOUND,
        summary="Report of a run: figures and tables in a page",
    )
    async def report(request: Request, run: str, *, fresh: bool = False) -> Response:
        """Return the report, which the first request renders within some seconds; `fresh` renders it again."""
        return await _page(request, await found(history.find, run), "report", fresh=fresh)

    @router.get("/{run}/replay", response_class=FileResponse, responses=NOT_FOUND, summary="Replay of a run as a page")
    async def replay(request: Request, run: str, *, fresh: bool = False) -> Response:
        """Return a page that shows the robot in 3D and needs no server; `fresh` renders it again."""
        return await _page(request, await found(history.find, run), "replay", fresh=fresh)

    @router.get(
        "/{run}/curves", responses=NOT_FOUND, summary="Error and force over time of each case, for a small plot"
    )
    async def curves(
        run: str,
        *,
        stored: Annotated[bool, Query(description="return only curves that an earlier request computed")] = False,
    ) -> dict[str, Curve]:
        """Return the curves of each case; a line has at most 240 points, and its peaks are kept."""
        folder = await found(history.find, run)
        if stored:
            return dict(await files.run(read_curves, folder) or {})
        async with rendering:
            known = await files.run(read_curves, folder)
            if known is None:
                await _command("curves", folder)
                known = await files.run(read_curves, folder)
        return dict(known or {})

    @router.delete(
        "/{run}",
        responses=NOT_FOUND | REFUSED_RESPONSES,
        dependencies=[Depends(of.require_operator)],
        summary="Delete a run; it can be restored for a day",
    )
    async def delete(
        run: str, confirm: Annotated[str, Query(description="the run's name, as a confirmation")] = ""
    ) -> DeletedOut:
        """Delete a run; `confirm` repeats the id of the run, so that no other run is deleted by mistake."""
        await found(history.delete, run, confirm)
        return DeletedOut(deleted=run)

    @router.post(
        "/{run}/restore",
        responses=NOT_FOUND | REFUSED_RESPONSES,
        dependencies=[Depends(of.require_operator)],
        summary="Restore a deleted run",
    )
    async def restore(run: str) -> RunDetails:
        """Restore a deleted run with its id and its files."""
        return await found(history.restore, run)

    async def _written(request: Request, name: str, *command: str) -> Response:
        """Run a command with an output path as its last argument; return the written file as the download `name`."""
        out = Path(await asyncio.to_thread(tempfile.mkdtemp, prefix="ctr-export-"))
        remove = partial(shutil.rmtree, out, ignore_errors=True)

        async def write() -> None:
            async with exports:
                await _command(*command, str(out / name))

        try:
            await cancel_on_disconnect(request, write())
        except BaseException:
            remove()
            raise
        media = guess_type(name)[0] or MCAP_MEDIA_TYPE
        return await stored_file(files, out, name, media, attachment=name, background=BackgroundTask(remove))

    async def _page(request: Request, folder: Path, command: str, *, fresh: bool) -> Response:
        path = folder / f"{command}.html"

        async def render() -> None:
            async with rendering:  # one report at a time, because rendering uses a whole processor for seconds
                if fresh or not await files.run(is_regular, path):
                    await _command(command, folder)

        await cancel_on_disconnect(request, render())
        headers = {"content-security-policy": STANDALONE_POLICY, "cache-control": "no-cache"}
        return await stored_file(files, folder, path.name, "text/html", headers=headers)

    return router


def _channels(recording: Path) -> ChannelsOut:
    with open_case(recording) as recorded:
        counts = fields_of(recorded.channels)
        fields = {name: FieldOut(columns=count, meaning=MEANINGS.get(name, "")) for name, count in counts.items()}
        return ChannelsOut(ticks=recorded.ticks, fields=fields)


async def _found(files: FileThreads, function: Any, *arguments: Any) -> Any:
    try:
        return await files.run(function, *arguments)
    except NoRunError as error:
        raise HTTPException(404, str(error)) from None


async def _command(command: str, run: Path | str, *options: str) -> None:
    """Run a command of `ctr-station` on a run in a separate process, to keep the station responsive."""
    folder = Path(run).absolute()
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "station", command, str(folder), *options,
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        _, errors = await process.communicate()
    except asyncio.CancelledError:
        process.kill()
        # A process that waits for a disk may not end.
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(process.wait(), KILL_TIMEOUT_S)
        raise
    if process.returncode:
        lines = errors.decode(errors="replace").strip().splitlines()
        reason = lines[-1] if lines else f"exit status {process.returncode}"
        raise RecordingError(f"the {command} of run '{folder.name}' failed: {reason}")
