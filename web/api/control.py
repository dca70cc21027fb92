"""REST: the state, start, STOP and reset, the next motion, the model, and telemetry."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response, WebSocket, WebSocketDisconnect

from core.robot.robot import Array
from station.config.controllers import PERIOD, ControllerFile
from station.config.robots import start_pose
from station.config.strict import preset_names
from station.control.states import State
from station.control.task import Phase
from station.experiments.experiment import offered
from station.service.solve import model_answer
from station.service.standing import standing
from station.service.start import Run
from station.service.station_service import StationService
from web.access.identity import who_of
from web.api.commands import Commands, aside, stopper
from web.api.experiments import experiments_out
from web.api.loop_health import RecentTiming
from web.api.pictures import picture
from web.api.schemas import (
    REFUSED,
    DoneOut,
    ErrorOut,
    ExperimentOut,
    SolveIn,
    SolveOut,
    StartIn,
    StartOut,
    StatusOut,
    TipMotionIn,
)
from web.api.status import status_out
from web.scene.contact import SideLoad
from web.scene.target_seen import TargetSeen

#: Groups of telemetry that websocket clients get.
STREAMED = (
    "time", "state", "phase", "held", "trouble", "truth_known", "joints", "tip_measured", "tip_estimated",
    "tip_desired", "tip_true", "force", "force_filtered", "u_int", "deflection", "deflection_filtered",
    "deflection_rate", "direction_measured", "direction_observed", "direction_desired", "direction_true",
    "target_followed", "target_measured", "target_offset", "target_true",
)  # fmt: skip
#: Sent to all websocket clients together [1/s]: many share them, or telemetry would take the station's whole processor.
SAMPLES = 400.0
#: Those of a single number.
SCALARS = ("time", "state", "phase", "held", "truth_known", "target_followed")


def control_routes(
    service: StationService, of: Commands, stopping: ThreadPoolExecutor, side_load: Callable[[], SideLoad | None]
) -> APIRouter:
    """Routes under /api for one station.

    Args:
        service: what requests may do.
        of: who may command.
        stopping: threads that wait for nothing but STOP.
        side_load: tells of a load that does not act at the tip.
    """
    router = APIRouter(prefix="/api", responses={422: REFUSED[422]}, dependencies=[Depends(of.heard)])
    supervisor = service.supervisor
    operator = [Depends(of.needed)]

    @router.get("/status", summary="Everything at one look")
    def status(request: Request) -> StatusOut:
        return status_out(service, of, who_of(request), side_load())

    @router.post(
        "/start", status_code=202, responses=REFUSED, dependencies=operator, summary="Start an experiment or a motion"
    )
    async def start(request: StartIn) -> StartOut:
        if request.experiment is not None:
            return started(await aside(service.start_experiment, request.experiment, request.case))
        return started(
            await aside(service.start_motion, request.trajectory, request.controller, request.load, request.duration)
        )

    @router.post(
        "/stop",
        responses={202: {"model": DoneOut, "description": "taken, not carried out yet; see the note"}},
        summary="Stop every axis; always accepted, from anybody with access",
    )
    async def stop(request: Request, response: Response) -> DoneOut:
        cause = f"stopped by {stopper(of.lease, who_of(request))}"
        note = await asyncio.get_running_loop().run_in_executor(stopping, supervisor.stop, cause)
        if note:
            response.status_code = 202
        return DoneOut(state=supervisor.status().state.name, note=note)

    @router.post(
        "/reset", responses=REFUSED, dependencies=operator, summary="Go on after a stop, hold or fault that was seen"
    )
    async def reset() -> DoneOut:
        note = await aside(supervisor.reset)
        return DoneOut(state=supervisor.status().state.name, note=note)

    @router.get("/trajectory", summary="The next free motion")
    def get_trajectory() -> TipMotionIn:
        return service.settings.trajectory

    @router.put("/trajectory", responses=REFUSED, dependencies=operator, summary="Choose the next free motion")
    def put_trajectory(trajectory: TipMotionIn) -> TipMotionIn:
        service.set_trajectory(trajectory)
        return service.settings.trajectory

    @router.get("/controller", summary="The controller of the next free motion")
    def get_controller() -> ControllerFile:
        return service.settings.controller

    @router.put("/controller", responses=REFUSED, dependencies=operator, summary="Choose the controller")
    def put_controller(controller: ControllerFile) -> ControllerFile:
        service.set_controller(controller)
        return service.settings.controller

    @router.get("/experiments", summary="Experiments, and why a file is none")
    def experiments() -> list[ExperimentOut]:
        return experiments_out(supervisor.bench)

    @router.get(
        "/experiments/{name}/picture.svg",
        responses={404: {"model": ErrorOut}},
        summary="Path and load of a case, the first when none is named",
    )
    def experiment_picture(name: str, case: str | None = None) -> Response:
        if name not in preset_names("experiments"):
            return Response(status_code=404)
        drawn = next((one for one in offered(name).cases if case in (None, one.name)), None)
        return Response(status_code=404) if drawn is None else Response(picture(drawn), media_type="image/svg+xml")

    @router.post("/model/solve", responses=REFUSED, summary="Ask the loaded model")
    def solve(request: SolveIn) -> SolveOut:
        joints = start_pose(request.joints, supervisor.bench.robot)
        answer = model_answer(supervisor.statics, joints, np.array([*request.force, *request.moment]))
        return SolveOut.model_validate(answer, strict=False)

    listeners = 0

    @router.websocket("/telemetry")
    async def telemetry(socket: WebSocket, rate: Annotated[float, Query(ge=1.0, le=100.0)] = 30.0) -> None:
        nonlocal listeners
        await socket.accept()
        listening = asyncio.create_task(_until_closed(socket))
        listeners += 1
        timing, target = RecentTiming(supervisor.ring), TargetSeen(supervisor.channels)
        try:
            since, before = supervisor.ring.written, None
            while not listening.done():
                await asyncio.wait([listening], timeout=max(1.0 / rate, listeners / SAMPLES))
                rows, since, overwritten = supervisor.ring.read(since)
                if len(rows):
                    sample = sample_out(service, rows[-1], len(rows) - 1 + overwritten, before)
                    before = sample["time"]
                    listeners -= 1  # one that does not read takes nothing from the others
                    try:
                        await socket.send_json(sample | timing.look() | {"target_seen": target.look(rows)})
                    finally:
                        listeners += 1
        except (WebSocketDisconnect, RuntimeError):
            return  # the other side has gone
        finally:
            listeners -= 1
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)

    return router


def started(run: Run) -> StartOut:
    """A run that has begun, for a reader."""
    return StartOut(run_id=run.id, warnings=run.start.warnings)


def sample_out(service: StationService, row: Array, skipped: int, before: float | None) -> dict[str, Any]:
    """One row of telemetry for a websocket client, with what lies between it and the one sent `before` it [s]."""
    channels = service.supervisor.channels
    old = standing(channels, row)
    values: dict[str, Any] = {}
    for group in STREAMED:
        numbers = channels.of(row, group).tolist()
        values[group] = numbers[0] if group in SCALARS else None if group in old else numbers
    # Not every period has a row: those that a late loop left out are in no count of rows.
    missed = 0 if before is None else max(0, round((values["time"] - before) / PERIOD) - 1 - skipped)
    named = {"state": State(int(values["state"])).name, "phase": Phase(int(values["phase"])).name.lower()}
    return {"skipped": skipped, "missed": missed, **values, **named}


async def _until_closed(socket: WebSocket) -> None:
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
