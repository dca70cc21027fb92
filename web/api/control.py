"""REST: the state, start, STOP and reset, the next motion, the model, and telemetry."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from inspect import Parameter, Signature
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Body, Depends, HTTPException, Query, Request, Response, WebSocket, WebSocketDisconnect

from core.control.fields import one
from core.robot.robot import Array
from station.config.controllers import PERIOD_S, ControllerFile
from station.config.robots import start_pose
from station.config.strict import preset_names
from station.control.commands import Command, Reset, Stop
from station.control.ring import Ring
from station.control.states import RefusedError, State
from station.control.task import Phase
from station.control.telemetry import FIELDS, stale_groups
from station.experiments.experiment import offered_experiment
from station.service.commands import COMMANDS, EXAMPLE_CONTROLLER, EXAMPLE_MOTION
from station.service.contact import SideLoad
from station.service.permits import Permit
from station.service.runs import RunRequest
from station.service.solve import model_answer
from station.service.supervisor import Outcome, Supervisor
from web.access.identity import sender_of
from web.api.commands import Commands, Permitted, described, stopper
from web.api.experiments import experiments_out, picture
from web.api.files import FileThreads
from web.api.schemas import (
    REFUSED_RESPONSES,
    DoneOut,
    ErrorOut,
    ExperimentOut,
    SolveIn,
    SolveOut,
    StartOut,
    StatusOut,
    TipMotionIn,
)
from web.api.status import status_out
from web.api.stop import Stops
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


#: Names of the fields of telemetry that are streamed to WebSocket clients.
STREAMED_GROUPS = tuple(field.name for field in FIELDS if field.streamed)
#: Largest rate of telemetry samples to all WebSocket clients together [1/s]. A higher rate would use a whole processor.
MAX_SAMPLES_PER_S = 400.0
#: Decimals of the sent values [SI units]: 1 nm, far below any noise. All digits would take half as many bytes more.
SENT_DECIMALS = 9
#: Names of the streamed fields that consist of a single number.
SCALAR_GROUPS = tuple(field.name for field in FIELDS if field.streamed and field.parts is one)


def control_routes(
    supervisor: Supervisor,
    of: Commands,
    stops: Stops,
    files: FileThreads,
    side_load: Callable[[], SideLoad | None],
    gateway_problem: Callable[[], str] | None = None,
) -> APIRouter:
    """Return the REST routes under /api that control one station.

    Args:
        supervisor: the station.
        of: dependencies that check the operator's lease.
        stops: executes STOP.
        files: threads that read the files of experiments.
        side_load: returns the load that acts on the shaft instead of the tip, or None.
        gateway_problem: returns why the gateway has ended (empty: it runs); None: the station has no gateway.
    """
    router = APIRouter(responses={422: REFUSED_RESPONSES[422]}, dependencies=[Depends(of.renew_lease)])

    @router.get("/api/status", summary="Status of the station")
    def status(request: Request) -> StatusOut:
        """Return in one answer state, cause, operator, run, devices, timing, joints, tips and force."""
        problem = None if gateway_problem is None else gateway_problem()
        who = sender_of(request)
        return status_out(supervisor, of, who, side_load(), problem, stops.own_cause(who))

    @router.post(Reset.path(), **described(Reset), **of.command)
    async def reset(request: Request, permit: Permitted) -> DoneOut:
        command = Reset(who=stopper(of.lease, sender_of(request)))
        return done(supervisor, await asyncio.to_thread(supervisor.send, command, permit))

    for command in COMMANDS:
        if command not in (Stop, Reset):  # their fields come from the server, not from the request
            add_command(router, supervisor, of, command)

    @router.get("/api/trajectory", summary="The next free motion")
    def get_trajectory() -> TipMotionIn:
        """Return the motion that a start without `trajectory` uses."""
        return supervisor.settings.trajectory

    @router.put("/api/trajectory", summary="Choose the next free motion", **of.command)
    def put_trajectory(trajectory: Annotated[TipMotionIn, Body(examples=[EXAMPLE_MOTION])]) -> TipMotionIn:
        """Set the motion of later starts; the present run does not change."""
        supervisor.change_settings(trajectory=trajectory)
        return supervisor.settings.trajectory

    @router.get("/api/controller", summary="The controller of the next free motion")
    def get_controller() -> ControllerFile:
        """Return the controller settings that a start without `controller` uses."""
        return supervisor.settings.controller

    @router.put("/api/controller", summary="Choose the controller", **of.command)
    def put_controller(controller: Annotated[ControllerFile, Body(examples=[EXAMPLE_CONTROLLER])]) -> ControllerFile:
        """Check and set the controller of later starts; the present run does not change."""
        supervisor.change_settings(controller=controller)
        return supervisor.settings.controller

    @router.get("/api/experiments", summary="Experiments; an invalid file is listed with its error")
    async def experiments(*, check: bool = True) -> list[ExperimentOut]:
        """List the experiments; with `check=false` without waiting for the check of their motions on the model."""
        return await files.run(experiments_out, supervisor.bench, check_motions=check)

    @router.get(
        "/api/experiments/{name}/picture.svg",
        responses={404: {"model": ErrorOut}},
        summary="Picture of a case's path and load; without `case` the first",
    )
    async def experiment_picture(name: str, case: str | None = None) -> Response:
        """Return the picture as SVG."""
        drawn = await files.run(_picture, name, case, supervisor.bench.robot_name)
        if drawn is None:
            raise HTTPException(404, f"there is no experiment '{name}' with case '{case}'; see GET /api/experiments")
        return Response(drawn, media_type="image/svg+xml")

    @router.post("/api/model/solve", responses=REFUSED_RESPONSES, summary="Solve the loaded model")
    def solve(request: SolveIn) -> SolveOut:
        """Return the answer of `ctr-station solve`: the shape for joint positions and a load on the tip."""
        joints = start_pose(request.joints, supervisor.bench.robot)
        answer = model_answer(supervisor.statics, joints, np.array([*request.force, *request.moment]))
        return SolveOut.model_validate(answer, strict=False)

    listeners = 0

    @router.websocket("/api/telemetry")
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
                        sample = sample_out(supervisor, rows[-1], len(rows) - 1 + overwritten, before)
                        before = sample["time"]
                        listeners -= 1  # a client that reads slowly must not reduce the rate of the others
                        try:
                            await socket.send_json(sample | timing.read() | {"target_visible": target.update(rows)})
                        finally:
                            listeners += 1
            finally:
                listeners -= 1

    return router


def _picture(name: str, case: str | None, robot: str) -> str | None:
    """Return the picture of the named case, or of the first case if `case` is None; None if there is no such case."""
    if name not in preset_names("experiments"):
        return None
    cases = offered_experiment(name, robot, check_motions=False).cases
    drawn = next((one for one in cases if case in (None, one.name)), None)
    return None if drawn is None else picture(drawn)


def add_command(router: APIRouter, supervisor: Supervisor, of: Commands, command: type[Command]) -> None:
    """Add the route of a command, whose fields are the body of the request."""

    async def send(permit: Permit, request: Command | None = None) -> StartOut | DoneOut:
        outcome = await asyncio.to_thread(supervisor.send, request or command(), permit)
        return run_out(outcome.started) if command.starts_run else done(supervisor, outcome)

    async def in_a_virtual_lab() -> None:
        if supervisor.bench.devices is not None:
            raise RefusedError("this rig has real devices; only a virtual lab accepts simulated loads and faults")

    # FastAPI reads the schema of the body from the signature.
    parameters = [Parameter("permit", Parameter.KEYWORD_ONLY, annotation=Permitted)]
    if command.model_fields:
        default, kind = (None, command | None) if command.may_be_empty else (Parameter.empty, command)
        parameters.append(Parameter("request", Parameter.KEYWORD_ONLY, default=default, annotation=kind))
    send.__signature__ = Signature(parameters)  # pyright: ignore[reportFunctionMemberAccess]
    send.__name__ = command.name
    router.add_api_route(
        command.path(), send, methods=[command.method], response_model=StartOut if command.starts_run else DoneOut,
        status_code=202 if command.starts_run else 200, responses=REFUSED_RESPONSES,
        # The lab is checked first, because a command that a real rig refuses must not make its sender operator.
        dependencies=[Depends(in_a_virtual_lab)] * command.needs_lab + [Depends(of.require_operator)],
        **described(command),
    )  # fmt: skip


def done(supervisor: Supervisor, outcome: Outcome) -> DoneOut:
    """Return the response for a command that was executed."""
    return DoneOut(state=supervisor.status().state.name, note=outcome.note)


def run_out(run: RunRequest) -> StartOut:
    """Return the response for a run that has started."""
    return StartOut(run_id=run.id, warnings=run.start.warnings)


def sample_out(supervisor: Supervisor, row: Array, skipped: int, before: float | None) -> dict[str, Any]:
    """Return one row of telemetry for a WebSocket client.

    Args:
        supervisor: the station.
        row: values of all telemetry channels.
        skipped: number of rows since the last sample that are not sent.
        before: time of the last sample [s]; None: this sample is the first.
    """
    channels = supervisor.channels
    stale, row = stale_groups(channels, row), np.round(row, SENT_DECIMALS)
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
