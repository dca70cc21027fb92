"""What the scene shows, and the target in it, over REST: for the page's switches, the keyboard and scripts."""

import asyncio
from collections.abc import Callable
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, WebSocket, WebSocketDisconnect

from core.robot.robot import Array
from station.config.strict import Direction, Strict, Vector
from station.control.loop import NOT_POINTED
from station.control.states import RefusedError
from station.service.station_service import StationService
from web.access.identity import who_of
from web.api.commands import Commands, aside
from web.api.control import started
from web.api.schemas import REFUSED, StartOut
from web.scene.legend import Legend, signs, tube_signs
from web.scene.overlays import Shown
from web.scene.view import View
from web.scene.views import VIEWS


class ShownOut(Shown):
    """What is shown, and whether the asker sees it."""

    connected: bool
    """the scene in the asker's page has its stream; without it the picture stands still"""


class TargetIn(Strict):
    """A place for the tip, and where it is to point there."""

    position: Vector
    """world frame [m]"""
    direction: Direction | None = None
    """world frame, where the station's controller controls it; left out: as before"""


class TargetOut(Strict):
    """The target and the way there."""

    position: Vector
    """world frame [m]"""
    direction: Vector | None
    """in which the tip is to point there, world frame; null where that is not controlled"""
    reachable: bool
    """along a straight way from where the tip is now, under the load that is on it now"""
    duration: float
    """of the motion there, with a stay at its end [s]"""
    reason: str
    """why it cannot be reached"""


def scene_routes(view: View, service: StationService, of: Commands) -> APIRouter:
    """Routes under /api/scene."""
    router = APIRouter(prefix="/api/scene", tags=["scene"], dependencies=[Depends(of.heard)])
    operator = [Depends(of.needed)]

    @router.get("", summary="What is shown beside the robot")
    def get_shown(request: Request) -> ShownOut:
        return ShownOut(**view.shown.model_dump(), connected=view.scene_server.open[who_of(request).client] > 0)

    @router.put("", responses=REFUSED, dependencies=operator, summary="Show something else")
    def put_shown(shown: Shown, request: Request) -> ShownOut:
        view.show(shown)
        return get_shown(request)

    @router.get("/legend", summary="What the marks mean, and the views that there are")
    def legend() -> Legend:
        supervisor = service.supervisor
        seen = signs(target=supervisor.bench.may_see_target)
        return Legend(signs=seen, tubes=tube_signs(supervisor.robot), views=VIEWS)

    @router.websocket("/tip")
    async def tip(
        socket: WebSocket,
        client: Annotated[str, Query(max_length=64)] = "",
        rate: Annotated[float, Query(ge=1.0, le=30.0)] = 8.0,
    ) -> None:
        """Sends what is drawn around the tip; a view's name that arrives moves the camera of the page `client`."""
        await socket.accept()
        listening = asyncio.create_task(_until_closed(socket, lambda asked: view.cameras.look(client, asked)))
        try:
            while not listening.done():
                await socket.send_json(view.drawn.told())
                await asyncio.wait([listening], timeout=1.0 / rate)
        except (WebSocketDisconnect, RuntimeError):
            return  # the other side has gone
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)

    @router.get("/target", summary="The target, and whether the tip can get there")
    def get_target() -> TargetOut:
        way = view.way_to_target()
        direction = view.target_direction
        return TargetOut(
            position=_three(view.target), direction=None if direction is None else _three(direction),
            reachable=way.motion is not None, duration=way.duration, reason=way.reason,
        )  # fmt: skip

    @router.put("/target", responses=REFUSED, dependencies=operator, summary="Put the target somewhere else")
    def put_target(target: TargetIn) -> TargetOut:
        if target.direction is None:
            view.place_target(np.array(target.position))
            return get_target()
        if view.pointing is None:
            raise RefusedError(NOT_POINTED)
        direction = np.array(target.direction)
        view.place_target(np.array(target.position), direction / np.linalg.norm(direction))
        return get_target()

    @router.post(
        "/target/go", status_code=202, responses=REFUSED, dependencies=operator, summary="Move the tip to the target"
    )
    async def go() -> StartOut:
        way = await aside(view.way_to_target)
        if way.motion is None:
            raise RefusedError(f"the target is out of reach: {way.reason}")
        # A controller that was chosen for the place alone would not turn the tip.
        controller = view.pointing if service.settings.controller.task == "position" else None
        return started(await aside(service.start_motion, way.motion, controller, None, way.duration))

    return router


def _three(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


async def _until_closed(socket: WebSocket, hear: Callable[[str], object]) -> None:
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return
        hear(message.get("text") or "")
