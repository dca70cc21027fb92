"""Work that nobody waits for any more is given up: a page that was closed while its report was being drawn."""

import asyncio
from collections.abc import Coroutine
from typing import Any

from fastapi import Request
from starlette.exceptions import HTTPException

#: Between two looks whether the asker is still there [s].
LOOK = 0.1


async def while_wanted(request: Request, work: Coroutine[Any, Any, None]) -> None:
    """Carry out `work` to its end, or cancel it as soon as the one who asked has gone.

    Raises:
        HTTPException: 499, which nobody reads.
    """
    task = asyncio.create_task(work)
    try:
        while not (await asyncio.wait([task], timeout=LOOK))[0]:
            if await request.is_disconnected():
                raise HTTPException(499, "whoever asked for it has gone")
        task.result()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
