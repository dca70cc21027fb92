"""The REST interface: everything the panel can do, for scripts."""

import asyncio
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import numpy as np
from fastapi import APIRouter, Query, WebSocket, WebSocketDisconnect

from core.robot import Array
from station.config import preset_names
from station.desk import Desk
from station.experiments.experiment import ControllerFile, load_experiment, start_pose
from station.solve import model_answer
from station.states import State
from station.supervisor import STALE, Status
from web.schemas import (
    CaseOut,
    DeviceOut,
    DoneOut,
    ErrorOut,
    ExperimentOut,
    LoopOut,
    RunOut,
    SolveIn,
    SolveOut,
    StartIn,
    StartOut,
    StatusOut,
    TipMotionIn,
)

T = TypeVar("T")
REFUSED: dict[int | str, dict[str, Any]] = {
    409: {"model": ErrorOut, "description": "the present state does not allow it"},
    422: {"model": ErrorOut, "description": "a value is missing, unknown or out of range"},
}
#: Groups of telemetry that websocket clients get.
STREAMED = (
    "time", "state", "joints", "tip_measured", "tip_estimated", "tip_desired", "tip_true", "force", "u_int",
    "deflection", "deflection_rate",
)  # fmt: skip


def api_routes(desk: Desk) -> APIRouter:
    """Routes under /api for one station."""
    router = APIRouter(prefix="/api", responses={422: REFUSED[422]})
    supervisor = desk.supervisor

    @router.get("/status", summary="Everything at one look")
    def status() -> StatusOut:
        return status_out(desk)

    @router.post("/start", status_code=202, responses=REFUSED, summary="Start an experiment or a free motion")
    async def start(request: StartIn) -> StartOut:
        if request.experiment is not None:
            return StartOut(run_id=await _aside(desk.start_experiment, request.experiment, request.case))
        run = await _aside(desk.start_motion, request.trajectory, request.controller, request.load, request.duration)
        return StartOut(run_id=run)

    @router.post("/stop", summary="Stop every axis; always accepted")
    async def stop() -> DoneOut:
        await _aside(supervisor.stop)
        return DoneOut(state=supervisor.status().state.name)

    @router.post("/reset", responses=REFUSED, summary="Go on after a stop, a hold or a fault that a person has seen")
    async def reset() -> DoneOut:
        await _aside(supervisor.reset)
        return DoneOut(state=supervisor.status().state.name)

    @router.get("/trajectory", summary="The next free motion")
    def get_trajectory() -> TipMotionIn:
        return desk.settings.trajectory

    @router.put("/trajectory", responses=REFUSED, summary="Choose the next free motion")
    def put_trajectory(trajectory: TipMotionIn) -> TipMotionIn:
        desk.set_trajectory(trajectory)
        return desk.settings.trajectory

    @router.get("/controller", summary="The controller of the next free motion")
    def get_controller() -> ControllerFile:
        return desk.settings.controller

    @router.put("/controller", responses=REFUSED, summary="Choose the controller of the next free motion")
    def put_controller(controller: ControllerFile) -> ControllerFile:
        desk.set_controller(controller)
        return desk.settings.controller

    @router.get("/experiments", summary="Experiments that come with the station")
    def experiments() -> list[ExperimentOut]:
        return [experiment_out(name) for name in preset_names("experiments")]

    @router.post("/model/solve", responses=REFUSED, summary="Ask the loaded model")
    def solve(request: SolveIn) -> SolveOut:
        joints = start_pose(request.joints, supervisor.bench.robot)
        answer = model_answer(supervisor.statics, joints, np.array([*request.force, *request.moment]))
        return SolveOut.model_validate(answer, strict=False)

    @router.websocket("/telemetry")
    async def telemetry(socket: WebSocket, rate: Annotated[float, Query(ge=1.0, le=100.0)] = 30.0) -> None:
        await socket.accept()
        listening = asyncio.create_task(_until_closed(socket))
        try:
            since = supervisor.ring.written
            while not listening.done():
                await asyncio.wait([listening], timeout=1.0 / rate)
                rows, since, missed = supervisor.ring.read(since)
                if len(rows):
                    await socket.send_json(sample_out(desk, rows[-1], len(rows) - 1 + missed))
        except (WebSocketDisconnect, RuntimeError):
            return  # the other side has gone
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)

    return router


def status_out(desk: Desk) -> StatusOut:
    """The station's status for a reader."""
    supervisor = desk.supervisor
    status = supervisor.status()
    stale = status.age > STALE or status.state is State.FAULT

    def vector(group: str) -> tuple[float, float, float] | None:
        return tuple(status.values[group].tolist()) if group in status.values else None

    known = "truth_known" in status.values and bool(status.values["truth_known"][0])
    names = supervisor.robot.joint_names
    task = supervisor.task
    run = None
    if status.run and task is not None:
        run = RunOut(
            id=status.run, title=status.title, phase=status.phase.name.lower(), progress=status.progress,
            duration=task.duration,
        )  # fmt: skip
    return StatusOut(
        state=status.state.name,
        cause=status.cause,
        stale=stale,
        age=round(status.age, 3),
        lab=supervisor.bench.lab.title,
        run=run,
        devices=_devices(status, stale=stale),
        loop=LoopOut(**status.timing._asdict()),
        joints=dict(zip(names, status.values["joints"].tolist(), strict=True)) if status.values else {},
        tip_measured=vector("tip_measured"),
        tip_estimated=vector("tip_estimated"),
        tip_desired=vector("tip_desired"),
        tip_true=vector("tip_true") if known else None,
        force=vector("force"),
    )


def experiment_out(name: str) -> ExperimentOut:
    """A preset for a reader."""
    experiment = load_experiment(name)
    return ExperimentOut(
        name=name,
        title=experiment.title,
        cases=tuple(
            CaseOut(
                name=case.name,
                duration=case.file.duration,
                strategy=case.file.controller.strategy,
                trajectory=case.file.trajectory.kind,
            )
            for case in experiment.cases
        ),
    )


def sample_out(desk: Desk, row: Array, skipped: int) -> dict[str, Any]:
    """One row of telemetry for a websocket client."""
    channels = desk.supervisor.channels
    values: dict[str, Any] = {}
    for group in STREAMED:
        numbers = channels.of(row, group).tolist()
        values[group] = numbers[0] if group in ("time", "state") else numbers
    return {"skipped": skipped, **values, "state": State(int(values["state"])).name}


def _devices(status: Status, *, stale: bool) -> dict[str, DeviceOut]:
    """The virtual lab's devices answer as long as the loop ticks."""
    if status.state is State.OFF:
        text = "not connected"
    elif stale:
        text = f"no data for {status.age:.1f} s; {status.cause or 'is the control process alive?'}"
    else:
        text = "simulated, answering"
    ok = not stale and status.state is not State.OFF
    return {name: DeviceOut(ok=ok, text=text) for name in ("stages", "tracker", "force_sensors")}


async def _aside(function: Callable[..., T], *arguments: Any) -> T:
    """Run what may wait for the control process in a thread, so that the page goes on."""
    return await asyncio.to_thread(function, *arguments)


async def _until_closed(socket: WebSocket) -> None:
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
