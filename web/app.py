"""The application and how it is served: audit, access checks, page, REST and the proxied scene on one port."""

import asyncio
import contextlib
import io
import socket
import sys
import threading
import webbrowser
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import uvicorn
import viser
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from fastapi_offline import FastAPIOffline
from rich.console import Console
from starlette.exceptions import HTTPException

from core.errors import CtrError
from station.control.realtime import leave_a_core
from station.control.states import RefusedError
from station.recording.history import History
from station.service.audit import Audit
from station.service.live_calibration import LiveCalibration
from station.service.station_file import load_station
from station.service.station_service import StationService
from station.service.supervisor import Supervisor
from web.access.audited import Audited
from web.access.gate import Access, is_loopback
from web.access.lease import Lease
from web.access.tokens import Tokens, new_tokens
from web.api.bench import bench_routes
from web.api.calibration import calibration_routes
from web.api.commands import commands, operator_routes
from web.api.control import control_routes
from web.api.operator_watchdog import tell_when_alone
from web.api.runs import runs_routes
from web.api.scene import scene_routes
from web.api.setpoints import setpoint_routes
from web.scene.proxy import viser_routes
from web.scene.view import View

STATIC = Path(__file__).parent / "static"
#: What the page may load: its own files only. The scene brings its own page.
POLICY = "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; frame-ancestors 'self'"
#: The control process has this long to compile and to begin [s].
START_TIME = 120.0
#: Folder of calibrations beside the runs.
CALIBRATIONS = "calibrations"
#: That a browser may send over a websocket [bytes].
LONGEST_MESSAGE = 64 * 1024


class PortError(CtrError):
    """A port that cannot be had."""


def serve(config: Path | None, changes: Mapping[str, Any], host: str, port: int, data: Path, *, browser: bool) -> int:
    """Run the station until Ctrl-C.

    Args:
        config: its file; None: the default station.
        changes: keys of that file that are to be otherwise.
        host: address to listen on.
        port: of page and REST; 0: any.
        data: folder of runs, calibrations and audit log.
        browser: open one on a terminal.

    Raises:
        ConfigError: the configuration cannot be.
        AuditError: the folder cannot be written.
        PortError: the port is in use.
        CtrError: the control process does not start.
    """
    out = Console(highlight=False, soft_wrap=True)
    station = load_station(config, changes)
    bench = station.bench()
    tokens = None if is_loopback(host) else new_tokens()
    with contextlib.closing(_listen(host, port)) as listening, contextlib.closing(Audit(data)) as audit:
        port = listening.getsockname()[1]
        out.print(f"ctr-station: {bench.title}")
        for warning in bench.warnings:
            out.print(f"warning: {warning}", markup=False)
        if station.own_core:
            bench = replace(bench, core=leave_a_core())
        supervisor = Supervisor(bench, data, audit)
        try:
            supervisor.open()
            supervisor.wait_ready(START_TIME)
            service = StationService(supervisor)
            calibration = LiveCalibration(supervisor, data / CALIBRATIONS)
            # viser knows no access control: loopback only, the page comes through our own port.
            with contextlib.redirect_stdout(io.StringIO()):  # it announces its own address
                scene = viser.ViserServer(host="127.0.0.1", port=_free_port(), verbose=False)
            view = View(scene, service)
            try:
                app = build_app(service, view, calibration, data, audit, host, port, tokens)
                settings = uvicorn.Config(
                    app, log_level="warning", ws_per_message_deflate=False, ws_max_size=LONGEST_MESSAGE,
                    timeout_graceful_shutdown=3, lifespan="on",
                )  # fmt: skip
                page = f"http://{_shown(host)}:{port}/"
                address = page + (f"?token={tokens.operator}" if tokens else "")
                if tokens:
                    out.print(f"read-only: {page}?token={tokens.viewer}")
                out.print(f"ctr-station is at {address}   (Ctrl-C ends it)")
                sys.stdout.flush()
                if browser and sys.stdout.isatty():
                    threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
                server = uvicorn.Server(settings)
                with contextlib.suppress(KeyboardInterrupt):
                    server.run(sockets=[listening])
            finally:
                calibration.close()
                view.close()
                with contextlib.redirect_stdout(io.StringIO()):
                    scene.stop()
        finally:
            supervisor.close()
    out.print("ctr-station has ended; every axis is stopped")
    return 0


def _listen(host: str, port: int) -> socket.socket:
    """A bound socket, so that a busy port is known before anything starts."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen(64)
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise PortError(f"port {port} on {host} cannot be had: {reason}; choose another with --port") from None
    return listening


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _shown(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def build_app(
    service: StationService,
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
        service: what requests may do.
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
        alone = asyncio.create_task(tell_when_alone(of.lease, service.supervisor))
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
    of = commands(Lease(service.supervisor.bench.clock.now))
    routes, app.state.scene = viser_routes(view.scene_server, of.lease, audit)
    app.include_router(control_routes(service, of, stopping, view.side_load))
    app.include_router(operator_routes(of))
    app.include_router(bench_routes(service, of, audit))
    app.include_router(scene_routes(view, service, of))
    app.include_router(setpoint_routes(service, of.lease, audit))
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
