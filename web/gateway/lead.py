"""A run whose tip goes where OpenIGTLink targets say: an operator starts it, and it goes on only as long as they do.

A target without such a run is forgotten. One that comes while the operator's lease has lapsed, or is another's, too:
the tip comes to rest, and the run ends.
"""

import asyncio
from typing import NamedTuple

from fastapi import APIRouter, Depends

from station.control.states import State
from station.service.audit import Audit
from station.service.leader import Leader, LeadIn, NotTaken, TooFast
from station.service.start import Run
from station.service.station_service import StationService
from web.access.identity import Who
from web.access.lease import Lease
from web.api.commands import Commands, aside
from web.api.control import started
from web.api.schemas import REFUSED, StartOut
from web.api.setpoints import LOOK, moves, over, until_over
from web.gateway.messages import Target


class _Led(NamedTuple):
    """The run that is on."""

    run: Run
    leader: Leader
    client: str  #: who has started it


class LedByTarget:
    """At most one run at a time; in the event loop of the web server."""

    def __init__(self, service: StationService, lease: Lease, audit: Audit) -> None:
        self._service, self._lease, self._audit = service, lease, audit
        self._led: _Led | None = None
        self._attending: set[asyncio.Task[None]] = set()

    def hear(self, target: Target) -> None:
        """A target has come."""
        led = self._led
        if led is None or not self._lease.holds(led.client):
            return
        now = self._service.supervisor.bench.clock.now()
        place: tuple[float, ...] = tuple(target.place.tolist())
        try:
            led.leader.count(now)
            self._service.lead(led.run, led.leader.place(place, now, target.sent))
        except (NotTaken, TooFast):
            return  # what was asked before stands; there is nobody on that line to be told

    async def start(self, who: Who, asked: LeadIn) -> Run:
        """Start a run for it.

        Raises:
            RefusedError: the state does not allow it.
            CtrError: the controller cannot be.
        """
        # Targets are in the world, as everything that OpenIGTLink is told.
        asked = asked.model_copy(update={"frame": "world"})
        run = await aside(self._service.start_led, asked)
        self._audit.write(str(who), f"targets of run {run.id}", who.where, "begun")
        task = asyncio.create_task(self._attend(run, who, asked))
        self._attending.add(task)
        task.add_done_callback(self._attending.discard)
        return run

    async def _attend(self, run: Run, who: Who, asked: LeadIn) -> None:
        supervisor = self._service.supervisor
        try:
            while not moves(self._service, run):
                # The answer to the start may come before the loop's first word of it.
                if over(self._service, run) and supervisor.status().state is not State.RUNNING:
                    return
                await asyncio.sleep(LOOK)
            row = supervisor.ring.latest()
            if row is not None:
                start = supervisor.channels.of(row, "tip_desired").copy()
                self._led = _Led(run, Leader(asked, start, supervisor.bench.clock.now()), who.client)
            await until_over(self._service, run)
        finally:
            self._led = None
            self._service.lead(run, None)
            self._audit.write(str(who), f"targets of run {run.id}", who.where, "ended")


def gateway_routes(led: LedByTarget, of: Commands) -> APIRouter:
    """The one route."""
    router = APIRouter(prefix="/api/gateway", tags=["gateway"], dependencies=[Depends(of.heard)])

    @router.post("/target", status_code=202, responses=REFUSED, summary="Start a run led by OpenIGTLink targets")
    async def target(asked: LeadIn, who: Who = Depends(of.needed)) -> StartOut:  # noqa: B008 - FastAPI's way
        """From now on the tip goes where TRANSFORM messages named `Target` say, as long as the lease is kept."""
        return started(await led.start(who, asked))

    return router
