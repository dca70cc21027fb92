"""The web application and its server: audit log, access checks, page, REST and the 3D scene on one port."""

import asyncio
import contextlib
import gc
import io
import socket
import sys
import threading
import webbrowser
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from functools import cache, reduce
from pathlib import Path
from typing import Any, cast

import uvicorn
import viser
from fastapi import Depends, FastAPI, Request, Response
from fastapi.responses import JSONResponse
from fastapi_offline import FastAPIOffline
from rich.console import Console
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.routing import Route
from starlette.types import ASGIApp

from station.recording.history import RunHistory
from station.service.audit import Audit
from station.service.calibration_choice import CalibrationChoice
from station.service.live_calibration import LiveCalibration
from station.service.run_queue import RunQueue
from station.service.supervisor import Supervisor
from web.access.audit_middleware import AuditMiddleware
from web.access.connections import Connections, connection_capacity, limited_scene_server
from web.access.gate import Access, bracketed, is_loopback
from web.access.identity import Tokens, new_tokens
from web.access.lease import Lease
from web.access.quiet_log import limit_log
from web.api.calibration import calibration_routes
from web.api.cameras import STREAM_MEDIA_TYPE, camera_routes
from web.api.commands import commands, operator_routes, watch_operator, with_permits
from web.api.control import control_routes
from web.api.experiments import waypoint_routes
from web.api.files import FileThreads
from web.api.queue import queue_routes
from web.api.refusals import answer_errors, require_utf8
from web.api.rig import bench_routes
from web.api.runs import MCAP_MEDIA_TYPE, runs_routes
from web.api.scene import scene_routes
from web.api.setpoints import setpoint_routes
from web.api.stop import Stops, stop_routes
from web.gateway.crtk_commands import CrtkCommands
from web.gateway.host import Gateway, TargetStreams, gateway_routes
from web.gateway.options import GatewayOptions
from web.scene.proxy import viser_routes
from web.scene.view import SceneView
from web.static_files import STATIC, CheckedFiles, page

#: Smallest response that is compressed [bytes]: a smaller one fits into a packet anyway. A higher level of compression
#: would save a few percent more and take twice the time.
MIN_COMPRESSED_BYTES, COMPRESSION_LEVEL = 1400, 5
#: Time limit for the control process to compile and start [s]. The start takes a minute, or several on a busy computer.
START_TIMEOUT_S = 600.0
#: Duration of the start after which the terminal prints the reason of the delay [s].
SLOW_START_S = 15.0
COMPILING = "still starting: the first start compiles the model, which takes a minute or more (Ctrl-C cancels)"
#: Name of the folder with the calibrations, in the data folder next to the runs.
CALIBRATIONS_FOLDER = "calibrations"
#: Longest WebSocket message from a client [bytes].
MAX_MESSAGE_BYTES = 64 * 1024
#: Number of STOP requests handled at the same time. Each request may wait for seconds if the stages do not answer.
STOPS_AT_ONCE = 32
#: Number of connections that the system queues before the server accepts them.
LISTEN_BACKLOG = 64
#: Time for which an idle connection stays open [s]. Many scripts poll every 5 or 10 s. With one of these times the
#: server would close a connection at the moment when the next request arrives.
KEEP_ALIVE_S = 17


#: Access tokens of this program, which stay the same when the station starts again.
_tokens = cache(new_tokens)


def serve_web(
    supervisor: Supervisor,
    listening: socket.socket,
    address: tuple[str, int],
    data: Path,
    audit: Audit,
    out: Console,
    options: GatewayOptions,
    choice: CalibrationChoice,
    interrupted: Callable[[], bool],
    *,
    browser: bool,
) -> None:
    """Run the web server until Ctrl-C or a restart by `choice`.

    Ctrl-C first stops the axes, even while requests are being handled.

    Args:
        supervisor: the station, whose processes have been started.
        listening: socket that listens at `address`.
        address: host and port of page and REST.
        data: folder of runs, calibrations and audit log.
        audit: audit log of commands and refusals.
        out: terminal for the messages to the operator.
        options: protocols and addresses of the gateway.
        choice: calibration that the station starts with.
        interrupted: returns whether the program has received a signal to end.
        browser: whether to open a browser; it is opened only if the output is a terminal.

    Raises:
        GatewayError: a part of the gateway is not available.
        CtrError: the control process does not start.
    """
    limit_log()
    host, port = address
    tokens = None if is_loopback(host) else _tokens()
    gateway = _gateway(supervisor, options, tokens, audit, out)
    calibration = LiveCalibration(supervisor, data / CALIBRATIONS_FOLDER, choice)
    # viser has no access control. Therefore viser listens on loopback only, and clients reach it through a proxy.
    with (
        contextlib.redirect_stdout(io.StringIO()),
        limited_scene_server(connection_capacity()),
    ):  # the output is redirected because viser prints its address
        scene = viser.ViserServer(host="127.0.0.1", port=_free_port(), verbose=False)
    view = SceneView(scene, supervisor)
    try:
        server = _server(build_app(supervisor, view, calibration, data, audit, host, port, tokens, gateway))
        # The main thread only waits for the station and for signals.
        ended = threading.Event()

        def run() -> None:
            try:
                server.run(sockets=[listening])
            finally:
                ended.set()

        web = threading.Thread(target=run, name="web")
        slow = threading.Timer(SLOW_START_S, out.print, [COMPILING])
        try:
            with contextlib.suppress(KeyboardInterrupt):
                web.start()  # before the devices are connected, which takes two seconds: the page shows their progress
                _print_address(out, host, port, tokens, browser=browser)
                slow.start()
                supervisor.wait_started(START_TIMEOUT_S)
                slow.cancel()
                # Objects that the start has created exist until the end, so garbage collections need not check them.
                gc.freeze()
                gc.enable()
                # `join` is not used: Python 3.11 considers a thread ended when a signal interrupts `join` (bpo-45274).
                while not (ended.wait(0.5) or interrupted() or choice.restart.is_set()):
                    pass
        finally:
            slow.cancel()
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


def _print_address(out: Console, host: str, port: int, tokens: Tokens | None, *, browser: bool) -> None:
    """Print the addresses of the page; with `browser`, open the page if the output is a terminal."""
    page = f"http://{bracketed(host)}:{port}/"
    url = page + (f"?token={tokens.operator}" if tokens else "")
    if tokens:
        out.print(f"read-only: {page}?token={tokens.viewer}")
    out.print(f"ctr-station is at {url}   (Ctrl-C stops it)")
    sys.stdout.flush()
    if browser and sys.stdout.isatty():
        threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()


def _gateway(
    supervisor: Supervisor, options: GatewayOptions, tokens: Tokens | None, audit: Audit, out: Console
) -> Gateway | None:
    """Start the gateway, print its addresses and return it; None if no protocol is requested."""
    if not options:
        return None
    gateway = Gateway(supervisor, options, tokens, audit)
    for line in gateway.wait_ready():
        out.print(line, markup=False)
    return gateway


def _server(app: ASGIApp) -> uvicorn.Server:
    """Return the web server of the application, with bounded connections."""
    connections = Connections(app, connection_capacity())
    settings = uvicorn.Config(
        connections, log_level="warning", ws_per_message_deflate=False, ws_max_size=MAX_MESSAGE_BYTES,
        timeout_graceful_shutdown=3, timeout_keep_alive=KEEP_ALIVE_S, lifespan="on", backlog=LISTEN_BACKLOG,
        proxy_headers=False,
    )  # fmt: skip
    settings.load()
    settings.http_protocol_class = cast("Any", connections.admitting(settings.http_protocol_class))
    return _Server(settings, connections)


class _Server(uvicorn.Server):
    """Web server with bounded connections."""

    def __init__(self, settings: uvicorn.Config, connections: Connections) -> None:
        super().__init__(settings)
        self._connections = connections

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Shut the server down without waiting for incomplete requests."""
        self._connections.end()
        await super().shutdown(sockets)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def build_app(
    supervisor: Supervisor,
    view: SceneView,
    calibration: LiveCalibration,
    runs: Path,
    audit: Audit,
    host: str,
    port: int,
    tokens: Tokens | None,
    gateway: Gateway | None = None,
) -> ASGIApp:
    """Return the station's web application.

    Args:
        supervisor: the station.
        view: 3D scene of the page.
        calibration: calibration procedures of the station.
        runs: folder of the recordings.
        audit: audit log of commands and refusals.
        host, port: address at which clients reach the application.
        tokens: access tokens, one of which every client needs; None on loopback.
        gateway: gateway of the station; None: the station has no gateway.
    """
    stopping = ThreadPoolExecutor(STOPS_AT_ONCE, "stop")
    queue, files = RunQueue(supervisor), FileThreads()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        queue.open()
        tasks = [asyncio.create_task(watch_operator(of.lease, supervisor.operator_gone))]
        if gateway is not None:
            tasks.append(asyncio.create_task(gateway.run(targets.receive, crtk)))
        yield
        for task in tasks:
            task.cancel()
        await asyncio.to_thread(queue.close)
        await app.state.scene.aclose()
        stopping.shutdown()

    app = FastAPIOffline(
        title="ctr-station",
        description="Lab station for externally loaded concentric-tube robots. SI units, world frame.",
        docs_url="/api/docs",
        redoc_url=None,
        openapi_url="/api/openapi.json",
        lifespan=lifespan,
        dependencies=[Depends(require_utf8)],
    )

    async def description(_request: Request) -> Response:
        # The first request generates the description, which takes a quarter of a second of processor time. In the
        # event loop this would delay STOP.
        return JSONResponse(await asyncio.to_thread(app.openapi))

    app.router.routes.insert(0, Route("/api/openapi.json", description))  # instead of FastAPI's own route
    of = commands(Lease(supervisor.bench.clock.now))
    routes, app.state.scene = viser_routes(view.scene_server, of.lease, audit)
    stops = Stops(supervisor, of.lease, stopping)
    app.include_router(stop_routes(stops, of, audit))
    problem = None if gateway is None else lambda: gateway.problem
    app.include_router(control_routes(supervisor, of, stops, files, view.side_load, problem))
    app.include_router(operator_routes(of))
    app.include_router(waypoint_routes(supervisor, runs, of, files))
    app.include_router(bench_routes(supervisor, of, audit, files))
    app.include_router(scene_routes(view, supervisor, of))
    app.include_router(setpoint_routes(supervisor, of.lease, audit))
    targets = TargetStreams(supervisor, of.lease, audit)
    crtk = CrtkCommands(supervisor, targets, of.lease, audit, stopping)
    if gateway is not None and (gateway.options.igtl or gateway.options.ros2):
        app.include_router(gateway_routes(targets, of))
    app.include_router(calibration_routes(calibration, of, files))
    app.include_router(camera_routes(supervisor, calibration.cameras, of))
    app.include_router(queue_routes(supervisor, queue, of))
    app.include_router(runs_routes(RunHistory(runs), of, files))
    app.include_router(routes)

    app.add_api_route("/", page, include_in_schema=False)
    app.mount("/static", CheckedFiles(directory=STATIC))
    answer_errors(app)

    def compressed(app: ASGIApp) -> ASGIApp:
        # Recordings and pictures are compressed already.
        return GZipMiddleware(
            app, minimum_size=MIN_COMPRESSED_BYTES, compresslevel=COMPRESSION_LEVEL,
            exclude_content_types=(*DEFAULT_EXCLUDED_CONTENT_TYPES, MCAP_MEDIA_TYPE, STREAM_MEDIA_TYPE),
        )  # fmt: skip

    # A request passes these wrappers in this order. Before them, `_server` bounds the number of open connections; after
    # them, `require_utf8` refuses invalid Unicode, and the route refuses commands of clients without the lease.
    wrappers: tuple[Callable[[ASGIApp], ASGIApp], ...] = (
        lambda inner: AuditMiddleware(inner, audit),  # refuses nothing; logs every change and every refusal
        lambda inner: Access(inner, host, port, tokens),  # other hosts and sites, no token, viewers, large bodies
        lambda inner: with_permits(inner, supervisor),  # refuses nothing; a later STOP voids the request's permit
        compressed,  # refuses nothing
    )
    return reduce(lambda inner, wrap: wrap(inner), reversed(wrappers), cast("ASGIApp", app))
