"""The REST interface: state, runs, motions and the model, for the page and for scripts."""

import asyncio
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response, WebSocket, WebSocketDisconnect

from core.robot import Array
from station.config import preset_names
from station.desk import Desk
from station.devices.interfaces import Severity
from station.experiments.experiment import ControllerFile, Experiment, load_experiment, start_pose
from station.solve import model_answer
from station.states import State
from station.status import STALE, Status
from web.commands import Commands, aside, operator_out
from web.pictures import picture
from web.schemas import (
    REFUSED,
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
from web.timing import RecentTiming
from web.who import Who, who_of
from web.words import words

#: Groups of telemetry that websocket clients get.
STREAMED = (
    "time", "state", "joints", "tip_measured", "tip_estimated", "tip_desired", "tip_true", "force", "u_int",
    "deflection", "deflection_rate",
)  # fmt: skip


def api_routes(desk: Desk, of: Commands, stopping: ThreadPoolExecutor) -> APIRouter:
    """Routes under /api for one station; `stopping` are threads that wait for nothing but STOP."""
    router = APIRouter(prefix="/api", responses={422: REFUSED[422]}, dependencies=[Depends(of.heard)])
    supervisor = desk.supervisor
    operator = [Depends(of.needed)]
    experiment = cache(load_experiment)

    @router.get("/status", summary="Everything at one look")
    def status(request: Request) -> StatusOut:
        return status_out(desk, of, who_of(request))

    @router.post(
        "/start", status_code=202, responses=REFUSED, dependencies=operator, summary="Start an experiment or a motion"
    )
    async def start(request: StartIn) -> StartOut:
        if request.experiment is not None:
            return StartOut(run_id=await aside(desk.start_experiment, request.experiment, request.case))
        run = await aside(desk.start_motion, request.trajectory, request.controller, request.load, request.duration)
        return StartOut(run_id=run)

    @router.post(
        "/stop",
        responses={202: {"model": DoneOut, "description": "taken, not carried out yet; see the note"}},
        summary="Stop every axis; always accepted, from anybody with access",
    )
    async def stop(response: Response) -> DoneOut:
        note = await asyncio.get_running_loop().run_in_executor(stopping, supervisor.stop)
        if note:
            response.status_code = 202
        return DoneOut(state=supervisor.status().state.name, note=note)

    @router.post(
        "/reset", responses=REFUSED, dependencies=operator, summary="Go on after a stop, hold or fault that was seen"
    )
    async def reset() -> DoneOut:
        await aside(supervisor.reset)
        return DoneOut(state=supervisor.status().state.name)

    @router.get("/trajectory", summary="The next free motion")
    def get_trajectory() -> TipMotionIn:
        return desk.settings.trajectory

    @router.put("/trajectory", responses=REFUSED, dependencies=operator, summary="Choose the next free motion")
    def put_trajectory(trajectory: TipMotionIn) -> TipMotionIn:
        desk.set_trajectory(trajectory)
        return desk.settings.trajectory

    @router.get("/controller", summary="The controller of the next free motion")
    def get_controller() -> ControllerFile:
        return desk.settings.controller

    @router.put("/controller", responses=REFUSED, dependencies=operator, summary="Choose the controller")
    def put_controller(controller: ControllerFile) -> ControllerFile:
        desk.set_controller(controller)
        return desk.settings.controller

    @router.get("/experiments", summary="Experiments that come with the station")
    def experiments() -> list[ExperimentOut]:
        return [experiment_out(experiment(name)) for name in preset_names("experiments")]

    @router.get(
        "/experiments/{name}/picture.svg",
        responses={404: {"model": ErrorOut}},
        summary="Path and load of its first case",
    )
    def experiment_picture(name: str) -> Response:
        if name not in preset_names("experiments"):
            return Response(status_code=404)
        return Response(picture(experiment(name).cases[0]), media_type="image/svg+xml")

    @router.post("/model/solve", responses=REFUSED, summary="Ask the loaded model")
    def solve(request: SolveIn) -> SolveOut:
        joints = start_pose(request.joints, supervisor.bench.robot)
        answer = model_answer(supervisor.statics, joints, np.array([*request.force, *request.moment]))
        return SolveOut.model_validate(answer, strict=False)

    @router.websocket("/telemetry")
    async def telemetry(socket: WebSocket, rate: Annotated[float, Query(ge=1.0, le=100.0)] = 30.0) -> None:
        await socket.accept()
        listening = asyncio.create_task(_until_closed(socket))
        timing = RecentTiming(supervisor.ring)
        try:
            since = supervisor.ring.written
            while not listening.done():
                await asyncio.wait([listening], timeout=1.0 / rate)
                rows, since, missed = supervisor.ring.read(since)
                if len(rows):
                    sample = sample_out(desk, rows[-1], len(rows) - 1 + missed)
                    await socket.send_json(sample | timing.look())
        except (WebSocketDisconnect, RuntimeError):
            return  # the other side has gone
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)

    return router


def status_out(desk: Desk, of: Commands, who: Who) -> StatusOut:
    """The station's status for `who` asks."""
    supervisor = desk.supervisor
    status = supervisor.status()
    stale = status.age > STALE

    def vector(group: str) -> tuple[float, float, float] | None:
        return tuple(status.values[group].tolist()) if group in status.values else None

    known = "truth_known" in status.values and bool(status.values["truth_known"][0])
    names, said = supervisor.robot.joint_names, words(status)
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
        phase=status.phase.name.lower(),
        says=said.what,
        next=said.next,
        operator=operator_out(of.lease, who),
        stale=stale,
        age=round(status.age, 3),
        lab=supervisor.bench.title,
        warnings=status.warnings,
        run=run,
        devices=_devices(status),
        loop=LoopOut(**status.timing._asdict()),
        joints=dict(zip(names, status.values["joints"].tolist(), strict=True)) if status.values else {},
        tip_measured=vector("tip_measured"),
        tip_estimated=vector("tip_estimated"),
        tip_desired=vector("tip_desired"),
        tip_true=vector("tip_true") if known else None,
        force=vector("force"),
    )


def experiment_out(experiment: Experiment) -> ExperimentOut:
    """A preset for a reader."""
    return ExperimentOut(
        name=experiment.name,
        title=experiment.title,
        cases=tuple(
            CaseOut(
                name=case.name,
                duration=case.file.duration,
                strategy=case.file.controller.strategy,
                trajectory=case.file.trajectory.kind,
                load=case.file.load.kind,
                start=case.file.start,
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


def _devices(status: Status) -> dict[str, DeviceOut]:
    """Lights of the devices; what was reported before the loop fell silent is not called good."""
    silent = status.age > STALE
    return {
        device.name: DeviceOut(
            severity=max(device.severity, Severity.FAULT if silent else 0),
            condition=device.condition,
            text=f"no word from it for {status.age:.1f} s; {status.cause or 'is the control process alive?'}"
            if silent
            else device.text,
        )
        for device in status.devices
    }


async def _until_closed(socket: WebSocket) -> None:
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
