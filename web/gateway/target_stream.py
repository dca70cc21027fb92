"""Runs whose tip follows OpenIGTLink targets; an operator starts such a run, and must stay operator.

A target is discarded if there is no such run, if the operator's lease has expired, or if another client is operator.
Without targets the tip comes to rest and the run ends.
"""

import asyncio
from functools import partial
from typing import NamedTuple

from fastapi import APIRouter, Depends

from station.control.states import State
from station.service.audit import Audit
from station.service.permits import Permit
from station.service.run_request import RunRequest
from station.service.setpoint_stream import SetpointRefused, SetpointStream, StreamAgreement
from station.service.station_service import StationService
from web.access.identity import Sender
from web.access.lease import Lease
from web.api.commands import Commands, Permitted, run_in_thread
from web.api.control import run_out
from web.api.schemas import REFUSED_RESPONSES, StartOut
from web.api.setpoints import RUN_POLL_INTERVAL_S, accepts_setpoints, has_ended, until_over
from web.gateway.messages import TargetMessage


class _TargetStream(NamedTuple):
    """The run that follows targets now."""

    run: RunRequest
    stream: SetpointStream
    client: str  #: identity of the client that started the run
    since: float  #: time from which the run accepts targets; earlier ones are discarded [s]


class TargetStreams:
    """Starts runs that follow targets, one at a time; all methods run in the event loop of the web server."""

    def __init__(self, service: StationService, lease: Lease, audit: Audit) -> None:
        self._service, self._lease, self._audit = service, lease, audit
        self._current: _TargetStream | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    def receive(self, target: TargetMessage) -> None:
        """Pass a received target on to the current run."""
        current = self._current
        if current is None or target.received < current.since or not self._lease.holds(current.client):
            return
        position: tuple[float, ...] = tuple(target.position.tolist())
        try:
            self._service.send_setpoint(current.run, current.stream.position(position, target.received, target.sent))
        except SetpointRefused:
            return  # the refusal is not reported, because OpenIGTLink has no answer to a target

    async def start(self, who: Sender, agreement: StreamAgreement, permit: Permit) -> RunRequest:
        """Start a run whose tip follows targets.

        Raises:
            RefusedError: the station's state does not allow a run.
            CtrError: the controller of the run is invalid.
        """
        # OpenIGTLink targets are in the world frame, so the frame of the agreement is overwritten.
        agreement = agreement.model_copy(update={"frame": "world"})
        run = await run_in_thread(partial(self._service.start_stream, agreement, permit=permit))
        self._audit.write(str(who), f"targets of run {run.id}", who.where, "started")
        task = asyncio.create_task(self._follow(run, who, agreement))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return run

    async def _follow(self, run: RunRequest, who: Sender, agreement: StreamAgreement) -> None:
        supervisor = self._service.supervisor
        try:
            while not accepts_setpoints(self._service, run):
                # Right after the start, the control loop may not yet report the run.
                if has_ended(self._service, run) and supervisor.status().state is not State.RUNNING:
                    return
                await asyncio.sleep(RUN_POLL_INTERVAL_S)
            row = supervisor.ring.latest()
            if row is not None:
                start = supervisor.channels.of(row, "tip_desired").copy()
                now = supervisor.bench.clock.now()
                self._current = _TargetStream(run, SetpointStream(agreement, start, now), who.client, now)
            await until_over(self._service, run)
        finally:
            self._current = None
            self._service.send_setpoint(run, None)
            self._audit.write(str(who), f"targets of run {run.id}", who.where, "ended")


def gateway_routes(targets: TargetStreams, of: Commands) -> APIRouter:
    """Return the route that starts a run for targets."""
    router = APIRouter(prefix="/api/gateway", tags=["gateway"], dependencies=[Depends(of.renew_lease)])

    @router.post(
        "/target", status_code=202, responses=REFUSED_RESPONSES, summary="Start a run that follows OpenIGTLink targets"
    )
    async def target(
        agreement: StreamAgreement,
        permit: Permitted,
        who: Sender = Depends(of.require_operator),  # noqa: B008 - required by FastAPI
    ) -> StartOut:
        """Start a run whose tip follows TRANSFORM messages named `Target`, while the client stays operator."""
        return run_out(await targets.start(who, agreement, permit))

    return router
