"""Detects the loss of the operator: the operator released the lease, or sent no request until the lease expired."""

import asyncio

from station.service.supervisor import Supervisor
from web.access.lease import Lease
from web.api.commands import run_in_thread

#: Interval between two checks of the operator's lease [s].
POLL_INTERVAL_S = 0.25


async def watch_operator(lease: Lease, supervisor: Supervisor) -> None:
    """Report to the station each time the operator is lost; run until cancelled."""
    had_operator = False
    while True:
        await asyncio.sleep(POLL_INTERVAL_S)
        has_operator = lease.holder() is not None
        if had_operator and not has_operator:
            await run_in_thread(supervisor.operator_gone)
        had_operator = has_operator
