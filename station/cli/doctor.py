"""`ctr-station doctor`: check whether this computer is suitable for a station, and explain each finding."""

import multiprocessing
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from station.benchmarks.loop import TimerProbe
from station.cli.machine import README, MachineFinding, setup_findings
from station.control.realtime import may_lock_memory, request_fifo
from station.control.sleep import TURN_OFF_SLEEP, keeper_command, never_sleeps

if TYPE_CHECKING:
    from station.service.station_file import Rig

#: Duration of the measurement of timer delays; longest waits for its start, and for the keeper that prevents sleep [s].
TIMER_PROBE_S, TIMER_START_TIMEOUT_S, KEEPER_TIMEOUT_S = 3.0, 20.0, 5.0


def findings(config: Path | None = None) -> Iterator[MachineFinding]:
    """Check scheduling, processors, memory, sleep, serial ports, the setup for a bench, the browser, a station file.

    Raises:
        ConfigError: the station file is invalid.
    """
    if config is not None:
        from station.cli.stage_settings import settings_findings
        from station.service.station_file import load_station

        rig = load_station(config).bench()
        yield _latency(rig)
        yield from settings_findings(rig)
    yield MachineFinding("Python", True, f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield MachineFinding(
        "processors", cores >= 2, f"{cores}; the control process uses one" if cores >= 2 else
        "only one: control and browser will disturb each other",
    )  # fmt: skip
    yield _scheduling()
    yield _punctuality()
    yield _memory()
    yield _shared_memory()
    yield _sleep()
    yield from _serial_ports()
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    yield MachineFinding(
        "browser", browser is not None,
        f"{browser}" if browser else "none found here; use another computer's browser; the browser tests need chromium",
    )  # fmt: skip


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "firefox")


def _scheduling() -> MachineFinding:
    """Check in a child process whether SCHED_FIFO is granted, so that this process keeps its scheduling."""
    receive, send = multiprocessing.get_context("spawn").Pipe(duplex=False)
    process = multiprocessing.get_context("spawn").Process(target=_try_fifo, args=(send,))
    process.start()
    send.close()
    granted = bool(receive.recv()) if receive.poll(10.0) else False
    process.join()
    receive.close()
    if granted:
        return MachineFinding("real time", True, "SCHED_FIFO is granted: the 500 Hz loop runs with little jitter")
    advice = {
        "linux": f"{_limit()}; ctr-station doctor --print limits | sudo tee /etc/security/limits.d/ctr-station.conf,"
        f" join the group dialout and log in again; or see {README} for a service or a container; or give CAP_SYS_NICE,"
        " e.g. sudo setcap cap_sys_nice,cap_ipc_lock+ep on a copy of the interpreter",
        "darwin": "macOS has no SCHED_FIFO for programs; use Linux for experiments",
    }.get(sys.platform, "this system has no SCHED_FIFO; use Linux for experiments")
    return MachineFinding("real time", False, f"SCHED_FIFO is refused: the loop still runs, with more jitter; {advice}")


def _try_fifo(send: Connection) -> None:
    send.send(request_fifo())


def _punctuality() -> MachineFinding:
    """Measure the delays of a timer without work; the delays of the control loop are never smaller."""
    with TimerProbe(None) as probe:
        deadline = time.monotonic() + TIMER_START_TIMEOUT_S
        while not probe.figures()["ticks"] and time.monotonic() < deadline:
            time.sleep(0.05)
        probe.clear()
        time.sleep(TIMER_PROBE_S)
        figures = probe.figures()
    late = figures["late_us"]
    text = (
        f"a timer without work woke {late['p50']:.0f} us late (median), {1e-3 * late['max']:.2g} ms at most, and"
        f" {figures['a_period_late']} of {figures['ticks']} times by 2 ms or more"
    )
    if not figures["a_period_late"]:
        return MachineFinding("timer", bool(figures["ticks"]), text)
    return MachineFinding(
        "timer", False, f"{text}: the loop cannot be better; use a computer that is not shared with others"
    )


def _memory() -> MachineFinding:
    if may_lock_memory():
        return MachineFinding("memory", True, "locking is allowed: the loop never waits for the disk")
    advice = "the file of 'ctr-station doctor --print limits' sets memlock to unlimited; or start with CAP_IPC_LOCK"
    if sys.platform != "linux":
        advice = "this system does not let programs lock memory; use Linux for experiments"
    return MachineFinding(
        "memory", False, f"locking is not allowed: a shortage of memory would make the loop late; {advice}"
    )


def _shared_memory() -> MachineFinding:
    from multiprocessing.shared_memory import SharedMemory

    try:
        memory = SharedMemory(create=True, size=1 << 22)
    except OSError as error:
        return MachineFinding("shared memory", False, f"not available ({error.strerror}); 4 MB are needed")
    memory.close()
    memory.unlink()
    return MachineFinding("shared memory", True, "available for telemetry")


def _sleep() -> MachineFinding:
    """Check whether a station can keep this computer awake: stages continue while it sleeps."""
    if never_sleeps():
        return MachineFinding("sleep", True, "it is turned off")
    try:
        keeper = subprocess.run(  # noqa: S603 - a fixed command
            keeper_command(lid=True), stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=KEEPER_TIMEOUT_S
        )
        refused = " ".join(keeper.stderr.split()) if keeper.returncode else ""
    except (OSError, subprocess.TimeoutExpired) as error:
        refused = str(error)
    if not refused:
        return MachineFinding("sleep", True, "the station prevents it while it runs")
    return MachineFinding("sleep", False, f"the station cannot prevent it ({refused}): {TURN_OFF_SLEEP}")


def _latency(rig: "Rig") -> MachineFinding:
    """Return the latency of a rig's stages, and the latency for which the controller plans if it differs."""
    sent, planned = rig.latency, rig.controlled(rig.controller).estimator.actuation
    text = f"each stage gets a velocity every {1e3 * sent.interval:.3g} ms, {1e3 * sent.delay:.3g} ms after it was sent"
    if (planned.command_interval, planned.transport_delay) != sent:
        text += (
            f"; the controller plans for {1e3 * planned.command_interval:.3g} ms and"
            f" {1e3 * planned.transport_delay:.3g} ms (keys command_interval, transport_delay)"
        )
    return MachineFinding("stages", True, text)


def _limit() -> str:
    import resource

    return f"the priority limit (rtprio) is {resource.getrlimit(resource.RLIMIT_RTPRIO)[1]}"


def _serial_ports() -> Iterator[MachineFinding]:
    from serial.tools.list_ports import comports

    ports = list(comports())
    named = ", ".join(f"{port.device} ({port.description})" for port in ports)
    yield MachineFinding("serial ports", True, named or "none; the virtual lab needs none")
    yield from setup_findings(port.device for port in ports)
