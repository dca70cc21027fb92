"""REST: the state, start, STOP and reset, the next motion, the model, and telemetry."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from functools import partial
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response, WebSocket, WebSocketDisconnect

from core.robot.robot import Array
from station.config.controllers import PERIOD_S, ControllerFile
from station.config.robots import start_pose
from station.config.strict import preset_names
from station.control.ring import Ring
from station.control.states import State
from station.control.task import Phase
from station.control.telemetry import stale_groups
from station.experiments.experiment import offered_experiment
from station.service.contact import SideLoad
from station.service.runs import RunRequest
from station.service.solve import model_answer
from station.service.station_service import StationService
from web.access.identity import sender_of
from web.api.commands import Commands, Permitted, stopper
from web.api.experiments import experiments_out, picture
from web.api.schemas import (
    REFUSED_RESPONSES,
    DoneOut,
    ErrorOut,
    ExperimentOut,
    MarkIn,
    SolveIn,
    SolveOut,
    StartIn,
    StartOut,
    StatusOut,
    StiffnessIn,
    StopOut,
    TipMotionIn,
)
from web.api.status import status_out
from web.scene.history import TargetVisibility

#: Shortest time over which the timing statistics are computed [s].
MIN_WINDOW_S = 1.0


class RecentTiming:
    """Lateness and work time of the control loop over about the last second."""

    def __init__(self, ring: Ring) -> None:
        self._ring = ring
        self._then = time.monotonic()
        self._late, self._busy = ring.late.copy(), ring.busy.copy()
        self._last: dict[str, float | None] = {"late_us": None, "tick_us": None}

    def read(self) -> dict[str, float | None]:
        """Return the 99th percentiles of lateness and work time [us]; None during the first second."""
        now = time.monotonic()
        if now - self._then >= MIN_WINDOW_S:
            late, busy = self._ring.late.copy(), self._ring.busy.copy()
            self._last = {"late_us": _p99(late - self._late), "tick_us": _p99(busy - self._busy)}
            self._then, self._late, self._busy = now, late, busy
        return self._last


def _p99(increase: np.ndarray) -> float | None:
    total = int(increase.sum())
    # The control process may have cleared its histograms: a negative increase is meaningless.
    if total <= 0 or increase.min() < 0:
        return None
    return float(np.searchsorted(np.cumsum(increase), 0.99 * total) + 1)


#: Names of the groups of telemetry channels that are streamed to WebSocket clients.
STREAMED_GROUPS = (
    "time", "state", "phase", "estimates_frozen", "trouble", "truth_known", "joints", "tip_measured",
    "tip_estimated", "tip_desired", "tip_true", "force", "force_filtered", "force_variance", "u_int", "deflection",
    "deflection_filtered", "deflection_rate", "direction_measured", "direction_observed", "direction_desired",
    "direction_true", "target_followed", "target_measured", "target_offset", "target_true",
    "contact_start", "stiffness",
)  # fmt: skip
#: Largest rate of telemetry samples to all WebSocket clients together [1/s]. A higher rate would use a whole processor.
MAX_SAMPLES_PER_S = 400.0
#: Names of the channel groups that consist of a single number.
SCALAR_GROUPS = ("time", "state", "phase", "estimates_frozen", "truth_known", "target_followed", "contact_start")


def control_routes(
    service: StationService,
    of: Commands,
    stopping: ThreadPoolExecutor,
    side_load: Callable[[], SideLoad | None],
    gateway_problem: Callable[[], str] | None = None,
) -> APIRouter:
    """Return the REST routes under /api that control one station.

    Args:
        service: operations of the station.
        of: dependencies that check the operator's lease.
        stopping: thread pool reserved for STOP.
        side_load: returns the load that acts on the shaft instead of the tip, or None.
        gateway_problem: returns why the gateway has ended (empty: it runs); None: the station has no gateway.
    """
    router = APIRouter(prefix="/api", responses={422: REFUSED_RESPONSES[422]}, dependencies=[Depends(of.renew_lease)])
    supervisor = service.supervisor
    stop_client = stop_cause = ""  # who sent the newest STOP, and the cause that the station reports for it

    @router.get("/status", summary="Status of the station")
    def status(request: Request) -> StatusOut:
        problem = None if gateway_problem is None else gateway_problem()
        who = sender_of(request)
        own = stop_cause if who.client == stop_client else ""
        return status_out(service, of, who, side_load(), problem, own)

    @router.post("/start", status_code=202, summary="Start an experiment or a motion", **of.command)
    async def start(request: StartIn, permit: Permitted) -> StartOut:
        if request.experiment is not None:
            start = partial(service.start_experiment, request.experiment, request.case, permit=permit)
        else:
            start = partial(
                service.start_motion, request.trajectory, request.controller, request.load, request.duration,
                permit=permit,
            )  # fmt: skip
        return run_out(await asyncio.to_thread(start))

    @router.post(
        "/stop",
        responses={202: {"model": StopOut, "description": "accepted, but not as usual; see `confirmed` and `note`"}},
        summary="Stop every axis; always accepted, from any client with access",
    )
    async def stop(request: Request, response: Response) -> StopOut:
        nonlocal stop_client, stop_cause
        who = sender_of(request)
        stop_client, stop_cause = who.client, f"stopped by {stopper(of.lease, who)}"
        outcome = await asyncio.get_running_loop().run_in_executor(stopping, supervisor.stop, stop_cause)
        if outcome.text:
            response.status_code = 202
        return StopOut(state=supervisor.status().state.name, note=outcome.text, confirmed=outcome.confirmed)

    @router.post("/reset", summary="Reset after STOPPED, HOLD or FAULT", **of.command)
    async def reset(request: Request, permit: Permitted) -> DoneOut:
        note = await asyncio.to_thread(supervisor.reset, stopper(of.lease, sender_of(request)), permit)
        return DoneOut(state=supervisor.status().state.name, note=note)

    @router.post("/mark", summary="Mark the present moment of the run in its recording", **of.command)
    def mark(request: MarkIn) -> DoneOut:
        supervisor.mark(request.text)
        return DoneOut(state=supervisor.status().state.name)

    @router.put("/stiffness", summary="Change the tip's stiffness in a motion that has one", **of.command)
    async def put_stiffness(request: StiffnessIn, permit: Permitted) -> DoneOut:
        await asyncio.to_thread(supervisor.set_stiffness, request.stiffness, permit)
        return DoneOut(state=supervisor.status().state.name)

    @router.get("/trajectory", summary="The next free motion")
    def get_trajectory() -> TipMotionIn:
        return service.settings.trajectory

    @router.put("/trajectory", summary="Choose the next free motion", **of.command)
    def put_trajectory(trajectory: TipMotionIn) -> TipMotionIn:
        service.set_trajectory(trajectory)
        return service.settings.trajectory

    @router.get("/controller", summary="The controller of the next free motion")
    def get_controller() -> ControllerFile:
        return service.settings.controller

    @router.put("/controller", summary="Choose the controller", **of.command)
    def put_controller(controller: ControllerFile) -> ControllerFile:
        service.set_controller(controller)
        return service.settings.controller

    @router.get("/experiments", summary="Experiments; an invalid file is listed with its error")
    def experiments(*, check: bool = True) -> list[ExperimentOut]:
        """With `check=false` the answer does not wait for the check of the motions on the model."""
        return experiments_out(supervisor.bench, check_motions=check)

    @router.get(
        "/experiments/{name}/picture.svg",
        responses={404: {"model": ErrorOut}},
        summary="Picture of a case's path and load; without `case` the first",
    )
    def experiment_picture(name: str, case: str | None = None) -> Response:
        if name not in preset_names("experiments"):
            return Response(status_code=404)
        drawn = next(
            (one for one in offered_experiment(name, check_motions=False).cases if case in (None, one.name)), None
        )
        return Response(status_code=404) if drawn is None else Response(picture(drawn), media_type="image/svg+xml")

    @router.post("/model/solve", responses=REFUSED_RESPONSES, summary="Solve the loaded model")
    def solve(request: SolveIn) -> SolveOut:
        joints = start_pose(request.joints, supervisor.bench.robot)
        answer = model_answer(supervisor.statics, joints, np.array([*request.force, *request.moment]))
        return SolveOut.model_validate(answer, strict=False)

    listeners = 0

    @router.websocket("/telemetry")
    async def telemetry(socket: WebSocket, rate: Annotated[float, Query(ge=1.0, le=100.0)] = 30.0) -> None:
        nonlocal listeners
        async with listening_to(socket) as listening:
            listeners += 1
            timing, target = RecentTiming(supervisor.ring), TargetVisibility(supervisor.channels)
            try:
                since, before = supervisor.ring.written, None
                while not listening.done():
                    await asyncio.wait([listening], timeout=max(1.0 / rate, listeners / MAX_SAMPLES_PER_S))
                    rows, since, overwritten = supervisor.ring.read(since)
                    if len(rows):
                        sample = sample_out(service, rows[-1], len(rows) - 1 + overwritten, before)
                        before = sample["time"]
                        listeners -= 1  # while this client delays sending, it does not slow other clients
                        try:
                            await socket.send_json(sample | timing.read() | {"target_visible": target.update(rows)})
                        finally:
                            listeners += 1
            finally:
                listeners -= 1

    return router


def run_out(run: RunRequest) -> StartOut:
    """Return the response for a run that has started."""
    return StartOut(run_id=run.id, warnings=run.start.warnings)


def sample_out(service: StationService, row: Array, skipped: int, before: float | None) -> dict[str, Any]:
    """Return one row of telemetry for a WebSocket client.

    Args:
        service: operations of the station.
        row: values of all telemetry channels.
        skipped: number of rows since the last sample that are not sent.
        before: time of the last sample [s]; None: this sample is the first.
    """
    channels = service.supervisor.channels
    stale = stale_groups(channels, row)
    values: dict[str, Any] = {}
    for group in STREAMED_GROUPS:
        numbers = channels.of(row, group).tolist()
        values[group] = None if group in stale else numbers[0] if group in SCALAR_GROUPS else numbers
    # A late control loop skips whole periods, for which no row exists, so they are counted from the times of the rows.
    missed = 0 if before is None else max(0, round((values["time"] - before) / PERIOD_S) - 1 - skipped)
    named = {"state": State(int(values["state"])).name, "phase": Phase(int(values["phase"])).name.lower()}
    return {"skipped": skipped, "missed": missed, **values, **named}


@asynccontextmanager
async def listening_to(
    socket: WebSocket, handle: Callable[[str], object] = lambda _: None
) -> AsyncIterator[asyncio.Task[None]]:
    """Accept a WebSocket and provide the task that passes its texts to `handle` until the client disconnects."""

    async def listen() -> None:
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            handle(message.get("text") or "")

    await socket.accept()
    listening = asyncio.create_task(listen())
    try:
        yield listening
    except (WebSocketDisconnect, RuntimeError):
        return  # the client has disconnected
    finally:
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)
