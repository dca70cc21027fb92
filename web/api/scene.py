"""View options of the scene and its target over REST, for the page's switches, the keyboard and scripts."""

import asyncio
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, WebSocket
from pydantic import ConfigDict

from core.robot.robot import Array
from station.config.strict import Direction, Position, Strict, Vector
from station.control.loop import NO_DIRECTION_CONTROL
from station.control.ring import STATE
from station.control.states import RefusedError, State
from station.service.commands import Start
from station.service.supervisor import Supervisor
from web.access.identity import sender_of
from web.api.commands import Commands, Permitted
from web.api.control import listening_to, run_out
from web.api.schemas import StartOut
from web.scene.cameras import VIEWS
from web.scene.marks import TUBE_MAGNIFICATION, Legend, signs, tube_signs
from web.scene.overlays import ViewOptions
from web.scene.view import SceneView

#: Largest rate of the close-up while nothing moves, when it shows noise only [1/s].
RATE_AT_REST_HZ = 2.0


class ViewOptionsOut(ViewOptions):
    """View options, and whether the scene in the client's page is connected."""

    connected: bool
    """whether the scene in the client's page is connected; without a connection the picture is frozen"""


class TargetIn(Strict):
    """A target position for the tip, and the desired direction there."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"position": [0.0, 0.01, 0.12]}]})

    position: Position
    """world frame [m]"""
    direction: Direction | None = None
    """desired direction of the tip, world frame; needs a controller that controls the direction; null: unchanged"""


class TargetOut(Strict):
    """The target, and whether the tip can reach it."""

    position: Vector
    """world frame [m]"""
    direction: Vector | None
    """desired direction of the tip there, world frame; null: the direction is not controlled"""
    reachable: bool
    """whether the tip can reach the target along a straight path from its present position, under the present load"""
    duration: float
    """duration of the motion, including the time at the target [s]"""
    reason: str
    """why the target cannot be reached; empty if it can be reached"""


def scene_routes(view: SceneView, supervisor: Supervisor, of: Commands) -> APIRouter:
    """Return the REST routes under /api/scene."""
    router = APIRouter(prefix="/api/scene", tags=["scene"], dependencies=[Depends(of.renew_lease)])

    @router.get("", summary="View options of the scene")
    def get_shown(request: Request) -> ViewOptionsOut:
        """Return the view options, which are the same in all pages."""
        return ViewOptionsOut(
            **view.shown.model_dump(), connected=view.scene_server.open[sender_of(request).client] > 0
        )

    @router.put("", summary="Set the view options", **of.command)
    def put_shown(shown: ViewOptions, request: Request) -> ViewOptionsOut:
        """Set the view options; omitted options are switched off."""
        view.show(shown)
        return get_shown(request)

    @router.get("/legend", summary="Legend of the scene, and the available views")
    def legend() -> Legend:
        """Return the colours and marks of the scene with their meaning, and the views."""
        entries = signs(target=supervisor.bench.can_track_target)
        tubes = tube_signs(supervisor.robot)
        return Legend(signs=entries, tubes=tubes, views=VIEWS, magnification=TUBE_MAGNIFICATION)

    @router.websocket("/tip")
    async def tip(
        socket: WebSocket,
        client: Annotated[str, Query(max_length=64)] = "",
        rate: Annotated[float, Query(ge=1.0, le=30.0)] = 8.0,
    ) -> None:
        """Stream the drawing around the tip, more slowly at rest. A received view name moves the camera of `client`."""
        async with listening_to(socket, lambda name: view.cameras.set_view(client, name)) as listening:
            while not listening.done():
                await socket.send_json(view.drawn.to_json())
                moves = int(supervisor.ring.counters[STATE]) in (State.RUNNING, State.HOMING)
                await asyncio.wait([listening], timeout=1.0 / (rate if moves else min(rate, RATE_AT_REST_HZ)))

    @router.get("/target", summary="The target, and whether the tip can reach it")
    def get_target() -> TargetOut:
        """Check the target for the present pose and load; nothing moves."""
        plan = view.target_check()
        direction = view.target_direction
        return TargetOut(
            position=_three(view.target), direction=None if direction is None else _three(direction),
            reachable=plan.motion is not None, duration=plan.duration, reason=plan.reason,
        )  # fmt: skip

    @router.put("/target", summary="Move the target", **of.command)
    def put_target(target: TargetIn) -> TargetOut:
        """Move only the mark of the target; `POST /api/scene/target/go` moves the tip."""
        if target.direction is None:
            view.set_target(np.array(target.position))
            return get_target()
        if view.pointing is None:
            raise RefusedError(NO_DIRECTION_CONTROL)
        direction = np.array(target.direction)
        view.set_target(np.array(target.position), direction / np.linalg.norm(direction))
        return get_target()

    @router.post("/target/go", status_code=202, summary="Move the tip to the target", **of.command)
    async def go(permit: Permitted) -> StartOut:
        """Move the tip to the target along a straight path, which is checked first."""
        supervisor.check(Start.name, Start.states, permit)
        plan = await asyncio.to_thread(view.motion_to_target)
        if plan.motion is None:
            raise RefusedError(f"the target cannot be reached: {plan.reason}")
        # A controller with the task "position" would not turn the tip to the target's direction.
        controller = view.pointing if supervisor.settings.controller.task == "position" else None
        start = Start(trajectory=plan.motion, controller=controller, duration=plan.duration)
        return run_out((await asyncio.to_thread(supervisor.send, start, permit)).started)

    return router


def _three(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z
