"""Notices when nobody commands any more: the operator's page was closed, or has said nothing for too long."""

import asyncio

from station.service.supervisor import Supervisor
from web.access.lease import Lease
from web.api.commands import aside

#: Between two looks [s].
LOOK = 0.25


async def tell_when_alone(lease: Lease, supervisor: Supervisor) -> None:
    """Tell the station each time that its operator has gone; until cancelled."""
    held = False
    while True:
        await asyncio.sleep(LOOK)
        holds = lease.holder() is not None
        if held and not holds:
            await aside(supervisor.operator_gone)
        held = holds
