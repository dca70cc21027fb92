"""A station with its page: starts the station's processes, then the web server, and stops the axes at the end."""

import contextlib
import socket
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from core.errors import CtrError
from station.control import ring
from station.control.realtime import last_core
from station.devices.links.link import clear_left_behind
from station.experiments.saved import use_saved
from station.service.audit import Audit
from station.service.calibration_choice import CalibrationChoice
from station.service.fallback_stop import StopOutcome
from station.service.station_file import load_station
from station.service.supervisor import Supervisor
from web.gateway.options import GatewayOptions

UNDRIVEN = "it moved no stages"
#: Socket send buffer of each client that does not read [bytes]; the kernel doubles it.
SEND_BUFFER_BYTES = 128 * 1024


class PortError(CtrError):
    """The station's port is not available."""


def serve(
    config: Path | None,
    changes: Mapping[str, Any],
    host: str,
    port: int,
    data: Path,
    options: GatewayOptions,
    interrupted: Callable[[], bool],
    *,
    browser: bool,
) -> int:
    """Run the station until Ctrl-C, and start it again each time its calibration changes.

    Args:
        config: path of the station file; None: the default station, a virtual lab.
        changes: values that replace keys of the station file.
        host: address to listen on.
        port: port of page and REST; 0: any free port.
        data: folder of runs, calibrations and audit log.
        options: protocols and addresses of the gateway.
        interrupted: returns whether the program has received a signal to end.
        browser: whether to open a browser; it is opened only if the output is a terminal.

    Returns:
        0 if every axis was confirmed to have stopped, otherwise 1.

    Raises:
        ConfigError: the configuration is invalid.
        AuditError: the audit log in the folder `data` cannot be written.
        PortError: the port is in use.
        GatewayError: a part of the gateway is not available.
        CtrError: the control process does not start.
    """
    out = Console(highlight=False, soft_wrap=True)
    options.check()
    ring.clear_left_behind()
    clear_left_behind()
    choice = CalibrationChoice(config, changes)
    use_saved(data)
    while True:
        choice.restart.clear()
        port, stopped = _serve_once(config, choice, host, port, data, options, interrupted, out, browser=browser)
        if not (choice.restart.is_set() and stopped.confirmed):
            break
        out.print("ctr-station starts again with another calibration")
        browser = False
    if stopped.confirmed:
        out.print(f"ctr-station has ended; {f'every axis is stopped: {stopped.text}' if stopped.text else UNDRIVEN}")
    return 0 if stopped.confirmed else 1


def _serve_once(
    config: Path | None, choice: CalibrationChoice, host: str, port: int, data: Path, options: GatewayOptions,
    interrupted: Callable[[], bool], out: Console, *, browser: bool,
) -> tuple[int, StopOutcome]:  # fmt: skip
    """Run the station until Ctrl-C or until its calibration changes; return its port, and whether every axis stopped.

    Raises: the errors of `serve`.
    """
    station = load_station(config, choice.changes)
    options = replace(options, origins=station.gateway_origins)
    bench = station.bench()
    with contextlib.closing(listen(host, port)) as listening, contextlib.closing(Audit(data)) as audit:
        port = listening.getsockname()[1]
        out.print(f"ctr-station: {bench.title}")
        for warning in bench.warnings:
            out.print(f"warning: {warning}", markup=False)
        if station.own_core:
            bench = replace(bench, core=last_core())
        supervisor = Supervisor(bench, data, audit)
        try:
            supervisor.open()
            # The web server's modules take a second to import. The station's processes need none of them, so that they
            # start meanwhile.
            from web.app import serve_web

            at = host, port
            serve_web(supervisor, listening, at, data, audit, out, options, choice, interrupted, browser=browser)
        finally:
            stopped = supervisor.end_control()  # needed if the web server never started; otherwise repeated
            supervisor.close()
            if not stopped.confirmed:
                sys.stderr.write(f"ctr-station has ended; {stopped.text}\n")
    return port, stopped


def listen(host: str, port: int) -> socket.socket:
    """Return a socket bound to the station's port, so that a busy port is reported before anything starts."""
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        # Inherited by every connection: otherwise TCP delays the body of an answer until its header is acknowledged,
        # which takes a client 40 ms.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        listening.bind((host, port))
        listening.listen()
    except (OSError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise PortError(f"port {port} on {host} is not available: {reason}; choose another with --port") from None
    return listening
