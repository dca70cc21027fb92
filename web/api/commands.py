"""The way of a command: from an operator, who holds the lease or takes it because nobody does."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

from fastapi import APIRouter, Depends, Request
from fastapi.exceptions import RequestValidationError
from starlette.requests import HTTPConnection

from core.errors import CtrError
from station.control.states import RefusedError
from web.access.identity import Who, clean_name, who_of
from web.access.lease import LENGTH, Lease
from web.access.tokens import Role
from web.api.schemas import REFUSED, OperatorIn, OperatorOut

T = TypeVar("T")


class Commands(NamedTuple):
    """Dependencies of routes, all on one lease."""

    lease: Lease
    heard: Callable[[HTTPConnection], Awaitable[None]]  #: any word of the holder keeps the lease
    needed: Callable[[Request], AsyncIterator[Who]]  #: for commands


def commands(lease: Lease) -> Commands:
    """For routes: `Depends(commands.heard)` on all of them, `Depends(commands.needed)` on those that command."""

    async def heard(connection: HTTPConnection) -> None:
        lease.renew(who_of(connection).client)

    async def needed(request: Request) -> AsyncIterator[Who]:
        who = who_of(request)
        with commanding(lease, who):
            yield who

    return Commands(lease, heard, needed)


@contextmanager
def commanding(lease: Lease, who: Who) -> Iterator[None]:
    """A command of `who` is carried out within.

    Raises:
        HeldError: somebody else holds the lease.
    """
    was_free = lease.holder() is None
    taken = lease.take(who.client, who.name)
    try:
        yield
    except RefusedError:
        raise  # the state forbids it: a command all the same
    except (RequestValidationError, CtrError):
        # What makes no sense makes nobody operator.
        if was_free and lease.holder() == taken:
            lease.release(who.client)
        raise


def operator_out(lease: Lease, who: Who) -> OperatorOut:
    """Who is operator, as `who` may see it."""
    holder = lease.holder()
    if holder is None:
        return OperatorOut(name=None, you=False, role=who.role, lapses_s=None)
    return OperatorOut(
        name=holder.name, you=holder.client == who.client, role=who.role, lapses_s=round(lease.left(), 1)
    )


def stopper(lease: Lease, who: Who) -> str:
    """Who has pressed STOP, for everybody to read: anybody may, and the operator should know who it was."""
    if lease.holds(who.client):
        return "the operator"
    return f"a viewer, '{who.name}'" if who.role is Role.VIEWER else f"'{who.name}', who is not the operator"


def operator_routes(of: Commands) -> APIRouter:
    """Routes under /api/operator."""
    router = APIRouter(prefix="/api/operator", tags=["operator"], dependencies=[Depends(of.heard)])
    lease = of.lease

    @router.get("", summary="Who is operator")
    async def get(request: Request) -> OperatorOut:
        return operator_out(lease, who_of(request))

    @router.post("", responses=REFUSED, summary=f"Become operator, or stay so; lapses {LENGTH:g} s after the last word")
    async def post(request: Request, wish: OperatorIn) -> OperatorOut:
        who = who_of(request)
        name = clean_name(wish.name or "") or who.name
        lease.take(who.client, name, over=wish.take_over)
        return operator_out(lease, who)

    @router.delete("", summary="Be operator no longer")
    async def delete(request: Request) -> OperatorOut:
        who = who_of(request)
        lease.release(who.client)
        return operator_out(lease, who)

    return router


async def aside(function: Callable[..., T], *arguments: Any) -> T:
    """Run what may wait for the control process in a thread, so that the page goes on."""
    return await asyncio.to_thread(function, *arguments)
