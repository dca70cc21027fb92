"""Dependencies of routes that send commands: the sender must be operator, or becomes operator if there is none."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from functools import partial
from inspect import cleandoc
from typing import Annotated, Any, NamedTuple, TypeVar

from fastapi import APIRouter, Depends, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from core.errors import CtrError
from station.control.commands import Command
from station.control.states import RefusedError
from station.service.permits import Permit
from station.service.supervisor import Supervisor
from web.access.identity import Role, Sender, clean_name, sender_of
from web.access.lease import LEASE_S, Lease
from web.api.schemas import REFUSED_RESPONSES, OperatorIn, OperatorOut

T = TypeVar("T")


class Commands(NamedTuple):
    """Dependencies of the REST routes that check or renew the operator's lease."""

    lease: Lease
    renew_lease: Callable[[HTTPConnection], Awaitable[None]]  #: renews the lease with any request of the operator
    require_operator: Callable[[Request], AsyncIterator[Sender]]  #: required by routes that send commands

    @property
    def command(self) -> dict[str, Any]:
        """Arguments of a route that sends commands."""
        return {"responses": REFUSED_RESPONSES, "dependencies": [Depends(self.require_operator)]}


def commands(lease: Lease) -> Commands:
    """Return the dependencies: `Depends(commands.renew_lease)` for all routes, `require_operator` for commands."""

    async def renew_lease(connection: HTTPConnection) -> None:
        lease.renew(sender_of(connection).client)

    async def require_operator(request: Request) -> AsyncIterator[Sender]:
        who, state = sender_of(request), request.scope["state"]
        async with commanding(lease, who, permit_of(request)) as state["permit"]:
            yield who

    return Commands(lease, renew_lease, require_operator)


def with_permits(app: ASGIApp, supervisor: Supervisor) -> ASGIApp:
    """Wrap `app` so that every request gets a permit as soon as its head has arrived, before its body."""

    async def permitted(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] in ("http", "websocket"):
            state = scope.setdefault("state", {})
            state["permit"] = supervisor.permit(state.get("gone"))
        await app(scope, receive, send)

    return permitted


def permit_of(connection: HTTPConnection) -> Permit:
    """Return the permit that `with_permits` gave to a request."""
    return connection.scope["state"]["permit"]


#: Type of the parameter by which the routes that move the robot, and the route of the reset, receive their permit.
Permitted = Annotated[Permit, Depends(permit_of)]


def described(command: type[Command]) -> dict[str, Any]:
    """Return summary, description and tag of a command's route."""
    text = cleandoc(command.__doc__ or "")
    return {"summary": text.split("\n")[0].rstrip("."), "description": text, "tags": ["commands"]}


#: Interval at which a pending command renews the lease of its sender [s].
RENEWAL_INTERVAL_S = 0.5


@asynccontextmanager
async def commanding(lease: Lease, who: Sender, permit: Permit) -> AsyncIterator[Permit]:
    """Provide the permit of a command of `who`; the permit is void as soon as `who` is not operator any longer.

    While the command is pending and its client is connected, the lease is renewed.

    Raises:
        LeaseHeldError: another client holds the lease.
    """
    was_free = lease.holder() is None
    taken = lease.keep(who.client, who.name)

    async def renew() -> None:
        nonlocal taken
        while not (permit.gone and permit.gone()):
            await asyncio.sleep(RENEWAL_INTERVAL_S)
            newest = lease.holder() == taken
            lease.renew(who.client)
            if newest and (renewed := lease.holder()):
                taken = renewed

    renewal = asyncio.create_task(renew())
    try:
        yield permit.on(partial(lease.ended, taken))
    except RefusedError:
        raise  # the station's state forbids the command; the sender stays operator, because the command was valid
    except (RequestValidationError, CtrError):
        # An invalid command does not make its sender operator.
        if was_free and lease.holder() == taken:
            lease.release(who.client)
        raise
    finally:
        renewal.cancel()


def operator_out(lease: Lease, who: Sender) -> OperatorOut:
    """Return the operator's name and the time left of the lease, for the client `who`."""
    holder = lease.holder()
    if holder is None:
        return OperatorOut(name=None, you=False, role=who.role, lapses_s=None)
    return OperatorOut(
        name=holder.name, you=holder.client == who.client, role=who.role, lapses_s=round(lease.left(), 1)
    )


def stopper(lease: Lease, who: Sender) -> str:
    """Return name and address of the sender of a STOP or a reset, as text for all clients."""
    holder = lease.holder()
    name = holder.name if holder is not None and holder.client == who.client else who.name
    text = f"'{name}'" if who.where in name else f"'{name}' ({who.where})"
    return f"viewer {text}" if who.role is Role.VIEWER else text


def operator_routes(of: Commands) -> APIRouter:
    """Return the REST routes under /api/operator."""
    router = APIRouter(prefix="/api/operator", tags=["operator"], dependencies=[Depends(of.renew_lease)])
    lease = of.lease

    @router.get("", summary="Who is operator")
    async def get(request: Request) -> OperatorOut:
        """Return the operator, the only client that may send commands; every client may send STOP."""
        return operator_out(lease, sender_of(request))

    @router.post(
        "",
        responses=REFUSED_RESPONSES,
        summary=f"Become or stay operator; the lease expires {LEASE_S:g} s after the last request",
    )
    async def post(request: Request, body: OperatorIn) -> OperatorOut:
        """Become operator or renew the lease, as any request of the operator does; `take_over` replaces another one."""
        who = sender_of(request)
        name = clean_name(body.name or "") or who.name
        lease.take(who.client, name, over=body.take_over)
        return operator_out(lease, who)

    @router.delete("", summary="Release the operator's lease")
    async def delete(request: Request) -> OperatorOut:
        """Release the lease; the next client that sends a command becomes operator."""
        who = sender_of(request)
        lease.release(who.client)
        return operator_out(lease, who)

    return router


#: Interval between two checks of the operator's lease [s].
LEASE_POLL_INTERVAL_S = 0.25


async def watch_operator(lease: Lease, lost: Callable[[], None]) -> None:
    """Call `lost` in a thread each time the lease has ended without a new operator; run until cancelled."""
    had_operator = False
    while True:
        await asyncio.sleep(LEASE_POLL_INTERVAL_S)
        has_operator = lease.holder() is not None
        if had_operator and not has_operator:
            await asyncio.to_thread(lost)
        had_operator = has_operator


#: Interval between two checks whether the client is still connected [s].
CONNECTION_POLL_INTERVAL_S = 0.1


async def cancel_on_disconnect(request: Request, work: Coroutine[Any, Any, T]) -> T:
    """Return the result of `work`, or cancel `work` as soon as the client disconnects.

    Raises:
        HTTPException: status 499: the client has disconnected, so no client receives this answer.
    """
    task = asyncio.create_task(work)
    try:
        while not (await asyncio.wait([task], timeout=CONNECTION_POLL_INTERVAL_S))[0]:
            if await request.is_disconnected():
                raise HTTPException(499, "the client has disconnected")
        return task.result()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
