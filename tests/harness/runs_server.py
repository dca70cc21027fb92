"""Server of the run history alone, on loopback: `python -m tests.harness.runs_server FOLDER PORT`."""

import sys
from pathlib import Path

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from core.errors import CtrError
from station.recording.history import RunHistory
from web.access.gate import Access
from web.access.lease import Lease
from web.api.commands import commands
from web.api.runs import runs_routes

if __name__ == "__main__":
    folder, port = Path(sys.argv[1]), int(sys.argv[2])
    app = FastAPI()
    app.include_router(runs_routes(RunHistory(folder), commands(Lease())))

    @app.exception_handler(CtrError)
    def wrong(_request: Request, error: CtrError) -> JSONResponse:
        return JSONResponse({"error": str(error)}, 422)

    @app.exception_handler(HTTPException)
    def other(_request: Request, error: HTTPException) -> JSONResponse:
        return JSONResponse({"error": str(error.detail)}, error.status_code)

    uvicorn.run(Access(app, "127.0.0.1", port, None), port=port, log_level="warning")
