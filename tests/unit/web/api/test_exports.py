"""Files for clients are written one at a time, and few requests wait for them."""

import asyncio

import pytest
from starlette.exceptions import HTTPException

from web.api.runs import Exports


def test_files_are_written_one_at_a_time_and_a_request_beyond_the_limit_is_refused() -> None:
    async def scenario() -> list[str]:
        exports, events, may_end = Exports(asyncio.Lock(), 2), list[str](), asyncio.Event()

        async def write(name: str) -> None:
            async with exports:
                events.append(f"{name} runs")
                await may_end.wait()

        first, second = asyncio.create_task(write("first")), asyncio.create_task(write("second"))
        await asyncio.sleep(0)
        with pytest.raises(HTTPException, match="2 files are being written"):
            await write("third")
        second.cancel()  # its client has disconnected
        await asyncio.gather(second, return_exceptions=True)
        fourth = asyncio.create_task(write("fourth"))
        await asyncio.sleep(0)
        assert events == ["first runs"]
        may_end.set()
        await asyncio.gather(first, fourth)
        return events

    assert asyncio.run(scenario()) == ["first runs", "fourth runs"]
