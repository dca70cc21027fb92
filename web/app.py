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
from typing import Any, cast

import uvicorn
import viser
from fastapi import Depends, FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import FileResponse, JSONResponse
from fastapi.staticfiles import StaticFiles
from fastapi_offline import FastAPIOffline
from rich.console import Console
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp

from core.errors import CtrError
from station.config.strict import complaints, key_of
from station.control import ring
from station.control.realtime import last_core
from station.control.states import RefusedError
from station.devices.links import port_lock
from station.experiments.saved import use_saved
from station.recording.history import History
from station.service.audit import Audit
from station.service.live_calibration import LiveCalibration
from station.service.station_file import load_station
from station.service.station_service import StationService
from station.service.supervisor import Supervisor
from web.access.audited import Audited
from web.access.connections import Connections, places
from web.access.gate import Access, is_loopback
from web.access.lease import Lease
from web.access.scene_door import guarded_scene
from web.access.tokens import Tokens, new_tokens
from web.api.bench import bench_routes
from web.api.calibration import calibration_routes
from web.api.commands import commands, operator_routes
from web.api.control import control_routes
from web.api.operator_watchdog import tell_when_alone
from web.api.readable import readable, refusal
from web.api.runs import runs_routes
from web.api.scene import scene_routes
from web.api.setpoints import setpoint_routes
from web.api.taught import taught_routes
from web.gateway.host import Gateway
from web.gateway.lead import LedByTarget, gateway_routes
from web.gateway.wanted import Wanted
from web.scene.proxy import viser_routes
from web.scene.view import View

STATIC = Path(__file__).parent / "static"
#: What the page may load: its own files only. The scene brings its own page.
POLICY = "default-src 'self'; img-src 'self' data:; style-src 'self' 'unsafe-inline'; frame-ancestors 'self'"
#: The control process has this long to compile and to begin: a minute alone, several beside other programs [s].
START_TIME = 600.0
#: After so long a person is told what it is doing [s].
SLOW_START = 15.0
COMPILING = "still starting: the first start compiles the model, which takes a minute or more (Ctrl-C gives up)"
#: Folder of calibrations beside the runs.
CALIBRATIONS = "calibrations"
#: That a browser may send over a websocket [bytes].
LONGEST_MESSAGE = 64 * 1024
#: That the system keeps for each connection whose other end does not read, half of it its own [bytes].
WAITING = 128 * 1024
#: Connections that are taken before the requests of those before them are read.
ACCEPTED_AT_ONCE = 64


class PortError(CtrError):
    """A port that cannot be had."""


def serve(
    config: Path | None, changes: Mapping[str, Any], host: str, port: int, data: Path, wanted: Wanted, *, browser: bool
) -> int:
    """Run the station until Ctrl-C.

    Args:
        config: its file; None: the default station.
        changes: keys of that file that are to be otherwise.
        host: address to listen on.
        port: of page and REST; 0: any.
        data: folder of runs, calibrations and audit log.
        wanted: of the gateway.
        browser: open one on a terminal.

    Returns:
        0 when every axis has been seen to stop, 1 when not.

    Raises:
        ConfigError: the configuration cannot be.
        AuditError: the folder cannot be written.
        PortError: the port is in use.
        GatewayError: a part of the gateway cannot be had.
        CtrError: the control process does not start.
    """
    out = Console(highlight=False, soft_wrap=True)
    wanted.check()
    ring.clear_left_behind()
    port_lock.clear_left_behind()
    station = load_station(config, changes)
    use_saved(data)
    bench = station.bench()
    with contextlib.closing(_listen(host, port)) as listening, contextlib.closing(Audit(data)) as audit:
        port = listening.getsockname()[1]
        out.print(f"ctr-station: {bench.title}")
        for warning in bench.warnings:
            out.print(f"warning: {warning}", markup=False)
        if station.own_core:
            bench = replace(bench, core=last_core())
        supervisor = Supervisor(bench, data, audit)
        try:
            supervisor.open()
            _serve_web(supervisor, listening, (host, port), data, audit, out, wanted, browser=browser)
        finally:
            stopped = supervisor.end_control()  # again, if it never came to serve
            supervisor.close()
            if not stopped.seen:
                sys.stderr.write(f"ctr-station has ended; {stopped.text}\n")
    if stopped.seen:
        out.print("ctr-station has ended; every axis is stopped")
    return 0 if stopped.seen else 1


def _serve_web(
    supervisor: Supervisor,
    listening: socket.socket,
    address: tuple[str, int],
    data: Path,
    audit: Audit,
    out: Console,
    wanted: Wanted,
    *,
    browser: bool,
) -> None:
    """Serve until Ctrl-C; the axes are stopped before anything else ends, whoever is in the middle of a request."""
    host, port = address
    tokens = None if is_loopback(host) else new_tokens()
    service = StationService(supervisor)
    gateway = _gateway(service, wanted, tokens, audit, out)
    calibration = LiveCalibration(supervisor, data / CALIBRATIONS)
    # viser knows no access control: loopback only, the page comes through our own port.
    with contextlib.redirect_stdout(io.StringIO()), guarded_scene(places()):  # it announces its own address
        scene = viser.ViserServer(host="127.0.0.1", port=_free_port(), verbose=False)
    view = View(scene, service)
    try:
        server = _server(build_app(service, view, calibration, data, audit, host, port, tokens, gateway))
        slow = threading.Timer(SLOW_START, out.print, [COMPILING])
        slow.start()
        try:
            supervisor.wait_ready(START_TIME)  # processes and stages came up meanwhile
        finally:
            slow.cancel()
        # The main thread hears the signals, and has nothing else to do.
        ended = threading.Event()

        def run() -> None:
            try:
                server.run(sockets=[listening])
            finally:
                ended.set()

        web = threading.Thread(target=run, name="web")
        page = f"http://{_shown(host)}:{port}/"
        at = page + (f"?token={tokens.operator}" if tokens else "")
        if tokens:
            out.print(f"read-only: {page}?token={tokens.viewer}")
        out.print(f"ctr-station is at {at}   (Ctrl-C ends it)")
        sys.stdout.flush()
        if browser and sys.stdout.isatty():
            threading.Thread(target=webbrowser.open, args=(at,), daemon=True).start()
        try:
            with contextlib.suppress(KeyboardInterrupt):
                web.start()
                # Not `join`: Python 3.11 takes a thread for ended when a signal interrupts that (bpo-45274).
                while not ended.wait(0.5):
                    pass
        finally:
            supervisor.end_control()
            server.should_exit = True
            if web.ident is not None:
                web.join()
    finally:
        if gateway is not None:
            gateway.close()
        calibration.close()
        view.close()
        with contextlib.redirect_stdout(io.StringIO()):
            scene.stop()


def _gateway(
    service: StationService, wanted: Wanted, tokens: Tokens | None, audit: Audit, out: Console
) -> Gateway | None:
    """Started, and told where, if any of it is wanted."""
    if not wanted:
        return None
    gateway = Gateway(service, wanted, tokens, audit)
    for line in gateway.wait_ready():
        out.print(line, markup=False)
    return gateway


def _server(app: ASGIApp) -> uvicorn.Server:
    """Of the application, with bounded connections."""
    connections = Connections(app, places())
    settings = uvicorn.Config(
        connections, log_level="warning", ws_per_message_deflate=False, ws_max_size=LONGEST_MESSAGE,
        timeout_graceful_shutdown=3, lifespan="on", backlog=ACCEPTED_AT_ONCE, proxy_headers=False,
    )  # fmt: skip
    settings.load()
    settings.http_protocol_class = cast("Any", connections.admitting(settings.http_protocol_class))
    return _Server(settings, connections)


class _Server(uvicorn.Server):
    """A server with bounded connections."""

    def __init__(self, settings: uvicorn.Config, connections: Connections) -> None:
        super().__init__(settings)
        self._connections = connections

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End, without the requests that are not whole yet."""
        self._connections.end()
        await super().shutdown(sockets)


def _listen(host: str, port: int) -> socket.socket:
    """A bound socket, so that a busy port is known before anything starts."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING)
        listening.bind((host, port))
        listening.listen(ACCEPTED_AT_ONCE)
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
    gateway: Gateway | None = None,
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
        gateway: of the same station, if it has one.
    """
    stopping = ThreadPoolExecutor(4, "stop")

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(tell_when_alone(of.lease, service.supervisor))]
        if gateway is not None:
            tasks.append(asyncio.create_task(gateway.run(led.hear)))
        yield
        for task in tasks:
            task.cancel()
        await app.state.scene.aclose()
        stopping.shutdown()

    app = FastAPIOffline(
        title="ctr-station",
        description="Lab station for externally loaded concentric-tube robots. SI units, world frame.",
        docs_url="/api/docs",
        redoc_url=None,
        openapi_url="/api/openapi.json",
        lifespan=lifespan,
        dependencies=[Depends(readable)],
    )
    of = commands(Lease(service.supervisor.bench.clock.now))
    routes, app.state.scene = viser_routes(view.scene_server, of.lease, audit)
    app.include_router(control_routes(service, of, stopping, view.side_load))
    app.include_router(operator_routes(of))
    app.include_router(taught_routes(service, runs, of))
    app.include_router(bench_routes(service, of, audit))
    app.include_router(scene_routes(view, service, of))
    app.include_router(setpoint_routes(service, of.lease, audit))
    led = LedByTarget(service, of.lease, audit)
    if gateway is not None and gateway.wanted.igtl is not None:
        app.include_router(gateway_routes(led, of))
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
        return refusal(_reason(error), 422)

    @app.exception_handler(RefusedError)
    def refused(_request: Request, error: RefusedError) -> JSONResponse:
        return refusal(str(error), 409)

    @app.exception_handler(CtrError)
    def wrong(_request: Request, error: CtrError) -> JSONResponse:
        return refusal(str(error), 422)

    @app.exception_handler(HTTPException)
    def other(_request: Request, error: HTTPException) -> JSONResponse:
        return refusal(str(error.detail), error.status_code, error.headers)

    app.openapi()  # now: the first to ask for it would hold up whoever presses STOP meanwhile
    return Audited(Access(app, host, port, tokens), audit)


def _reason(error: RequestValidationError) -> str:
    """The complaints in one line: fields, values, what was expected."""
    errors = error.errors()
    if errors[0]["type"] == "json_invalid":
        return f"the body is not JSON: {errors[0].get('ctx', {}).get('error', '')}"
    return "; ".join(complaints(errors, lambda loc: _field(loc, error.body), "field"))


def _field(loc: tuple[int | str, ...], body: Any) -> str:
    """Where in a request something is, rows and numbers counted from one: `trajectory.points, row 1, number 4`."""
    *parts, last = key_of(loc[1:] if loc[:1] in (("body",), ("query",)) else loc, body).split(".")
    places = [f"number {int(last) + 1}"] if last.isdecimal() else []
    name = ".".join(parts if places else (*parts, last))
    head, _, row = name.rpartition(".")
    if places and row.isdecimal():
        return f"{head}, row {int(row) + 1}, {places[0]}"
    return ", ".join((name, *places)) or "body"
