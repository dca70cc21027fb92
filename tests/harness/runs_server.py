"""Server of the run history alone, on loopback: `python -m tests.harness.runs_server FOLDER PORT`."""

import math
import sys
from pathlib import Path
from typing import Any, cast

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.types import Receive, Scope, Send

from core.errors import CtrError
from station.recording.history import RunHistory
from station.service.permits import Permit
from web.access.gate import Access
from web.access.lease import Lease
from web.api.commands import commands
from web.api.files import FileThreads
from web.api.runs import runs_routes

#: Permit of requests that send no command to a robot.
NO_COMMAND = Permit(cast(Any, None), 0, math.inf)

if __name__ == "__main__":
    folder, port = Path(sys.argv[1]), int(sys.argv[2])
    app = FastAPI()
    app.include_router(runs_routes(RunHistory(folder), commands(Lease()), FileThreads()))

    @app.exception_handler(CtrError)
    def wrong(_request: Request, error: CtrError) -> JSONResponse:
        return JSONResponse({"error": str(error)}, 422)

    @app.exception_handler(HTTPException)
    def other(_request: Request, error: HTTPException) -> JSONResponse:
        return JSONResponse({"error": str(error.detail)}, error.status_code)

    async def permitted(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            scope.setdefault("state", {})["permit"] = NO_COMMAND
        await app(scope, receive, send)

    uvicorn.run(Access(permitted, "127.0.0.1", port, None), port=port, log_level="warning")
