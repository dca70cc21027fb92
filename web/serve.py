"""`ctr-station serve`: control process, scene, REST and page, from the first to the last."""

import contextlib
import io
import socket
import sys
import threading
import webbrowser
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import uvicorn
import viser
from rich.console import Console

from core.errors import CtrError
from station.control.realtime import leave_a_core
from station.service.audit import Audit
from station.service.live_calibration import LiveCalibration
from station.service.station_file import load_station
from station.service.station_service import Desk
from station.service.supervisor import Supervisor
from web.access.gate import is_loopback
from web.access.tokens import new_tokens
from web.app import build_app
from web.scene.view import View

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
            out.print(f"mind: {warning}", markup=False)
        if station.own_core:
            bench = replace(bench, core=leave_a_core())
        supervisor = Supervisor(bench, data, audit)
        try:
            supervisor.open()
            supervisor.wait_ready(START_TIME)
            desk = Desk(supervisor)
            calibration = LiveCalibration(supervisor, data / CALIBRATIONS)
            # viser knows no access control: loopback only, the page comes through our own port.
            with contextlib.redirect_stdout(io.StringIO()):  # it announces its own address
                scene = viser.ViserServer(host="127.0.0.1", port=_free_port(), verbose=False)
            view = View(scene, desk)
            try:
                app = build_app(desk, view, calibration, data, audit, host, port, tokens)
                settings = uvicorn.Config(
                    app, log_level="warning", ws_per_message_deflate=False, ws_max_size=LONGEST_MESSAGE,
                    timeout_graceful_shutdown=3, lifespan="on",
                )  # fmt: skip
                page = f"http://{_shown(host)}:{port}/"
                address = page + (f"?token={tokens.operator}" if tokens else "")
                if tokens:
                    out.print(f"for those who only look: {page}?token={tokens.viewer}")
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
