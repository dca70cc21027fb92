"""Cancel the work of a request when its client disconnects, for example while a report is being rendered."""

import asyncio
from collections.abc import Coroutine
from typing import Any, TypeVar

from fastapi import Request
from starlette.exceptions import HTTPException

T = TypeVar("T")

#: Interval between two checks whether the client is still connected [s].
POLL_INTERVAL_S = 0.1


async def cancel_on_disconnect(request: Request, work: Coroutine[Any, Any, T]) -> T:
    """Return the result of `work`, or cancel `work` as soon as the client disconnects.

    Raises:
        HTTPException: status 499: the client has disconnected, so no client receives this answer.
    """
    task = asyncio.create_task(work)
    try:
        while not (await asyncio.wait([task], timeout=POLL_INTERVAL_S))[0]:
            if await request.is_disconnected():
                raise HTTPException(499, "the client has disconnected")
        return task.result()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
