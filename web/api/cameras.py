"""Cameras over REST: their list, pictures as a stream or one by one, and the overlay of the model.

A camera encodes pictures only while a client requests them.
"""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, WebSocket
from fastapi.responses import Response, StreamingResponse
from pydantic import ConfigDict, Field
from starlette.exceptions import HTTPException

from station.camera.host import CameraHost
from station.camera.messages import CameraPicture
from station.config.strict import Name, Strict
from station.service.camera_calibration import BoardState, CameraCalibration
from station.service.camera_overlay import CameraOverlay, overlay
from station.service.supervisor import Supervisor
from web.access.connections import TRY_AGAIN_LATER
from web.api.commands import Commands
from web.api.control import listening_to
from web.api.schemas import ErrorOut

#: Media type of a stream of pictures, which a browser shows in an image element.
STREAM_MEDIA_TYPE = "multipart/x-mixed-replace"
BOUNDARY = "ctr-station-picture"
#: Interval between two checks for a new picture [s].
POLL_INTERVAL_S = 0.02
#: Longest wait for the picture of a snapshot, in real time [s].
SNAPSHOT_TIMEOUT_S = 4.0
#: Largest number of streams at the same time, of all cameras and clients; each needs a share of this computer.
MAX_STREAMS = 8
#: Smallest and largest side of a square of the calibration board [m].
MIN_SQUARE_M, MAX_SQUARE_M = 0.005, 0.2
#: Number of checks for a new picture after which a stream checks whether its client is connected.
CHECK_EVERY = 50

NO_CAMERA: dict[int | str, dict[str, Any]] = {404: {"model": ErrorOut, "description": "no such camera"}}
NO_PICTURE: dict[int | str, dict[str, Any]] = {
    503: {"model": ErrorOut, "description": "the camera delivers no picture, or too many clients view pictures"}
}


class CameraOut(Strict):
    """A camera and its state."""

    name: str
    width: int
    """columns of a picture"""
    height: int
    """rows of a picture"""
    simulated: bool
    """whether the virtual lab renders the pictures"""
    problem: str
    """what is wrong and what to do; empty if nothing is wrong"""
    rate: float
    """frames that arrive in a second [1/s]"""
    age: float | None
    """time since the exposure of the newest frame [s]; null: no frame yet"""
    watched: bool
    """whether clients view the camera's pictures; otherwise none are encoded"""
    calibrated: bool
    """whether lens and pose are known, so that the model can be drawn over the picture"""


def camera_out(host: CameraHost) -> CameraOut:
    """Return the state of a camera as a response."""
    status, camera = host.status(), host.camera
    return CameraOut(
        name=host.name, width=camera.width, height=camera.height, simulated=camera.simulated, problem=status.problem,
        rate=round(status.rate, 1), age=None if status.age is None else round(status.age, 3),
        watched=host.watched, calibrated=camera.view is not None,
    )  # fmt: skip


class BoardIn(Strict):
    """Cameras to calibrate, and the size of the board's squares."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"cameras": ["left", "right"], "square": 0.035}]})

    cameras: tuple[Name, ...] = Field(min_length=1, max_length=2, strict=False)
    """names of one camera or of two"""
    square: Annotated[float, Field(ge=MIN_SQUARE_M, le=MAX_SQUARE_M)] = 0.035
    """side of a square of the board, measured on the print [m]"""


class BoardOut(Strict):
    """State of the calibration of cameras; null before the first one."""

    board: BoardState | None


def camera_routes(supervisor: Supervisor, calibration: CameraCalibration, of: Commands) -> APIRouter:
    """Return the REST routes under /api/cameras."""
    router = APIRouter(prefix="/api/cameras", tags=["cameras"], dependencies=[Depends(of.renew_lease)])
    cameras = supervisor.cameras
    streams = 0

    def found(name: str) -> CameraHost:
        host = cameras.find(name)
        if host is None:
            names = ", ".join(host.name for host in cameras) or "none; add a table [cameras.NAME] to the station file"
            raise HTTPException(404, f"there is no camera '{name}'; the cameras are: {names}")
        return host

    @router.get("", summary="Every camera with its state")
    def listed() -> tuple[CameraOut, ...]:
        """List the cameras; `problem` states what is wrong with a camera and what to do."""
        return tuple(camera_out(host) for host in cameras)

    @router.get("/board.svg", response_class=Response, summary="The calibration board, to print at 100 %")
    def board(square: Annotated[float, Query(ge=MIN_SQUARE_M, le=MAX_SQUARE_M)] = 0.035) -> Response:
        """Return the board to scale; measure a printed square, because many printers change the size."""
        from station.camera.board import board_svg  # imports OpenCV

        headers = {"content-disposition": 'inline; filename="board.svg"'}
        return Response(board_svg(square), media_type="image/svg+xml", headers=headers)

    @router.get("/calibration", summary="State of the calibration of cameras")
    def board_state() -> BoardOut:
        """Return the state of the calibration: the number of pictures taken, and what to do next."""
        return BoardOut(board=calibration.state)

    @router.post("/calibration", status_code=202, summary="Start to take pictures of the board", **of.command)
    async def start_board(request: BoardIn) -> BoardOut:
        """Start to take pictures: each camera takes one whenever the board has moved to a new pose."""
        await asyncio.to_thread(calibration.start, request.cameras, request.square)
        return BoardOut(board=calibration.state)

    @router.post("/calibration/finish", status_code=202, summary="Compute the calibration", **of.command)
    async def finish_board() -> BoardOut:
        """Compute the result in the background; the state of the calibration shows when it is ready."""
        await asyncio.to_thread(calibration.finish)
        return BoardOut(board=calibration.state)

    @router.post("/calibration/cancel", summary="End the calibration without a result", **of.command)
    async def cancel_board() -> BoardOut:
        """End the calibration and discard all pictures of the board."""
        await asyncio.to_thread(calibration.cancel)
        return BoardOut(board=calibration.state)

    @router.get(
        "/{name}/stream",
        response_class=StreamingResponse,
        responses=NO_CAMERA | NO_PICTURE | {200: {"content": {STREAM_MEDIA_TYPE: {}}, "description": "JPEG pictures"}},
        summary="Live pictures as Motion JPEG",
    )
    async def stream(name: str, request: Request) -> StreamingResponse:
        """Stream pictures until the client disconnects; a slow client skips pictures."""
        host = found(name)
        if streams >= MAX_STREAMS:
            raise HTTPException(503, f"{MAX_STREAMS} streams of pictures are open, which is the limit; close a page")

        async def parts() -> AsyncIterator[bytes]:
            nonlocal streams
            streams += 1
            try:
                async for picture in _pictures(host, request.is_disconnected):
                    yield _part(picture)
            finally:
                streams -= 1

        media_type = f"{STREAM_MEDIA_TYPE}; boundary={BOUNDARY}"
        return StreamingResponse(parts(), media_type=media_type, headers={"cache-control": "no-store"})

    @router.websocket("/{name}/pictures")
    async def pictures(name: str, socket: WebSocket) -> None:
        """Send JPEG pictures as binary messages; unlike a stream, this takes none of a browser's few connections."""
        nonlocal streams
        host = cameras.find(name)
        async with listening_to(socket) as listening:

            async def ended() -> bool:
                return listening.done()

            if host is None or streams >= MAX_STREAMS:
                reason = "there is no such camera" if host is None else f"{MAX_STREAMS} streams of pictures are open"
                await socket.close(TRY_AGAIN_LATER, reason)
                return
            streams += 1
            try:
                async for picture in _pictures(host, ended):
                    await socket.send_bytes(picture.jpeg)
            finally:
                streams -= 1

    async def _pictures(host: CameraHost, ended: Callable[[], Awaitable[bool]]) -> AsyncIterator[CameraPicture]:
        """Yield new pictures until the client or the station ends; a slow client receives only the newest ones."""
        last, checks = host.picture, 0
        while not cameras.closed:
            host.watch()
            picture, checks = host.picture, checks + 1
            if picture is not None and picture is not last:
                last = picture
                yield picture
            if checks % CHECK_EVERY == 0 and await ended():
                return
            await asyncio.sleep(POLL_INTERVAL_S)

    @router.get(
        "/{name}/snapshot",
        response_class=Response,
        responses=NO_CAMERA | NO_PICTURE | {200: {"content": {"image/jpeg": {}}, "description": "a JPEG picture"}},
        summary="One picture",
    )
    async def snapshot(name: str) -> Response:
        """Return the newest picture of the camera as JPEG."""
        host, loop = found(name), asyncio.get_running_loop()
        last, end = host.picture, loop.time() + SNAPSHOT_TIMEOUT_S
        while (picture := host.picture) is None or picture is last:
            if loop.time() > end or cameras.closed:
                raise HTTPException(503, f"camera '{name}' delivers no picture: {host.status().problem or 'too slow'}")
            host.watch()
            await asyncio.sleep(POLL_INTERVAL_S)
        file = f"{name}-{datetime.now().astimezone():%Y%m%d-%H%M%S}.jpg"
        headers = {"cache-control": "no-store", "content-disposition": f'inline; filename="{file}"'}
        return Response(picture.jpeg, media_type="image/jpeg", headers=headers)

    @router.get("/{name}/overlay", responses=NO_CAMERA, summary="The model in the pixels of the newest picture")
    def get_overlay(name: str) -> CameraOverlay:
        """Return the centre line of each tube and the tips in pixels; `reason` states why there is no overlay."""
        host = found(name)
        return overlay(
            supervisor, host.camera, supervisor.bench.clock.now() if host.picture is None else host.picture.time
        )

    return router


def _part(picture: CameraPicture) -> bytes:
    head = f"--{BOUNDARY}\r\ncontent-type: image/jpeg\r\ncontent-length: {len(picture.jpeg)}\r\n"
    return f"{head}x-exposed: {picture.time:.6f}\r\n\r\n".encode() + picture.jpeg + b"\r\n"
