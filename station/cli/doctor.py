"""`ctr-station doctor`: check whether this computer is suitable for a station, and explain each finding."""

import multiprocessing
import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection

from station.benchmarks.loop import TimerProbe
from station.cli.machine import README, MachineFinding, setup_findings
from station.control.realtime import may_lock_memory, request_fifo

#: Duration of the measurement of timer delays, and longest wait for the start of that measurement [s].
TIMER_PROBE_S, TIMER_START_TIMEOUT_S = 3.0, 20.0


def findings() -> Iterator[MachineFinding]:
    """Check scheduling, processors, memory, serial ports, the setup for a bench, and the browser."""
    yield MachineFinding("Python", True, f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield MachineFinding(
        "processors", cores >= 2, f"{cores}; one is for the control process" if cores >= 2 else
        "only one: control and browser will disturb each other",
    )  # fmt: skip
    yield _scheduling()
    yield _punctuality()
    yield _memory()
    yield _shared_memory()
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
        f" join the group dialout and log in again; for a service or a container {README}; or start with CAP_SYS_NICE,"
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
    advice = "the same file sets memlock to unlimited; or start with CAP_IPC_LOCK"
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


#: Advice about one serial port for each stage. Its effect on the error of the tip has not been measured.
ONE_PORT_PER_STAGE = (
    "each of three Zaber stages gets a command every 25 ms on one chain, every 10 ms on separate ports:"
    " see station/devices/README.md, 'One chain or a port for each stage'"
)


def _limit() -> str:
    import resource

    return f"the priority limit (rtprio) is {resource.getrlimit(resource.RLIMIT_RTPRIO)[1]}"


def _serial_ports() -> Iterator[MachineFinding]:
    from serial.tools.list_ports import comports

    ports = list(comports())
    named = ", ".join(f"{port.device} ({port.description})" for port in ports)
    text = named or "none; the virtual lab needs none"
    if ports:
        text += f"; {ONE_PORT_PER_STAGE}"
    yield MachineFinding("serial ports", True, text)
    yield from setup_findings(port.device for port in ports)
