"""The application: audit, access checks, page, REST and the proxied scene on one port."""

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from fastapi_offline import FastAPIOffline
from starlette.exceptions import HTTPException

from core.errors import CtrError
from station.control.states import RefusedError
from station.recording.history import History
from station.service.audit import Audit
from station.service.live_calibration import LiveCalibration
from station.service.station_service import Desk
from web.access.audited import Audited
from web.access.gate import Access
from web.access.lease import Lease
from web.access.tokens import Tokens
from web.api.bench import bench_routes
from web.api.calibration import calibration_routes
from web.api.commands import commands, operator_routes
from web.api.motion import api_routes
from web.api.operator_watchdog import tell_when_alone
from web.api.runs import runs_routes
from web.api.scene import scene_routes
from web.scene.proxy import viser_routes
from web.scene.view import View

STATIC = Path(__file__).parent / "static"
#: What the page may load: its own files only. The scene brings its own page.
POLICY = "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; frame-ancestors 'self'"


def build_app(
    desk: Desk,
    view: View,
    calibration: LiveCalibration,
    runs: Path,
    audit: Audit,
    host: str,
    port: int,
    tokens: Tokens | None,
) -> Audited:
    """The station's web application.

    Args:
        desk: what requests may do.
        view: the scene behind the page.
        calibration: of the same station.
        runs: folder with the recordings.
        audit: where commands and refusals are written down.
        host, port: where the application will be reached.
        tokens: demanded from everybody; None on loopback.
    """
    stopping = ThreadPoolExecutor(4, "stop")

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        alone = asyncio.create_task(tell_when_alone(of.lease, desk.supervisor))
        yield
        alone.cancel()
        await app.state.scene.aclose()
        stopping.shutdown()

    app = FastAPIOffline(
        title="ctr-station",
        description="Lab station for externally loaded concentric-tube robots. SI units, world frame.",
        docs_url="/api/docs",
        redoc_url=None,
        openapi_url="/api/openapi.json",
        lifespan=lifespan,
    )
    of = commands(Lease(desk.supervisor.bench.clock.now))
    routes, app.state.scene = viser_routes(view.door, of.lease, audit)
    app.include_router(api_routes(desk, of, stopping, view.felt))
    app.include_router(operator_routes(of))
    app.include_router(bench_routes(desk, of, audit))
    app.include_router(scene_routes(view, desk, of))
    app.include_router(calibration_routes(calibration, of))
    app.include_router(runs_routes(History(runs), of))
    app.include_router(routes)

    @app.get("/", include_in_schema=False)
    def page() -> FileResponse:
        headers = {"cache-control": "no-cache", "content-security-policy": POLICY}
        return FileResponse(STATIC / "index.html", headers=headers)

    app.mount("/static", StaticFiles(directory=STATIC))

    @app.exception_handler(RequestValidationError)
    def invalid(_request: Request, error: RequestValidationError) -> JSONResponse:
        # The input stays out of the answer: a NaN in it could not be sent back.
        return JSONResponse({"error": _reason(error)}, 422)

    @app.exception_handler(RefusedError)
    def refused(_request: Request, error: RefusedError) -> JSONResponse:
        return JSONResponse({"error": str(error)}, 409)

    @app.exception_handler(CtrError)
    def wrong(_request: Request, error: CtrError) -> JSONResponse:
        return JSONResponse({"error": str(error)}, 422)

    @app.exception_handler(HTTPException)
    def other(_request: Request, error: HTTPException) -> JSONResponse:
        return JSONResponse({"error": str(error.detail)}, error.status_code, headers=error.headers)

    return Audited(Access(app, host, port, tokens), audit)


def _reason(error: RequestValidationError) -> str:
    """The first complaint in one line: field, value, what was expected."""
    first, count = error.errors()[0], len(error.errors())
    field = ".".join(str(part) for part in first["loc"] if part not in ("body", "query")) or "body"
    more = f" (and {count - 1} more)" if count > 1 else ""
    if first["type"] == "extra_forbidden":
        return f"unknown field '{field}'{more}"
    if first["type"] == "missing":
        return f"'{field}' is missing{more}"
    if first["type"] == "json_invalid":
        return f"the body is not JSON: {first.get('ctx', {}).get('error', '')}"
    shown = repr(first.get("input"))
    return f"{field} = {shown if len(shown) < 80 else shown[:77] + '...'}: {first['msg']}{more}"
