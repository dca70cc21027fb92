"""`ctr-station doctor`: what this machine offers, in plain words."""

import multiprocessing
import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection

from station.bench.timer_probe import TimerProbe
from station.cli.machine import README, Finding, set_up
from station.control.realtime import ask_for_fifo, may_lock_memory

#: A timer is watched for so long, once it has started [s].
WATCHED, STARTS = 3.0, 20.0


def findings() -> Iterator[Finding]:
    """Look at scheduling, processors, shared memory, serial ports, what was set up for a bench, and browser."""
    yield Finding("Python", True, f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield Finding(
        "processors", cores >= 2, f"{cores}; the control process wants one of its own" if cores >= 2 else
        "only one: control and browser will disturb each other",
    )  # fmt: skip
    yield _scheduling()
    yield _punctuality()
    yield _memory()
    yield _shared_memory()
    yield from _serial_ports()
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    yield Finding(
        "browser", browser is not None,
        f"{browser}" if browser else "none found here; open the panel elsewhere; the browser tests need chromium",
    )  # fmt: skip


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "firefox")


def _scheduling() -> Finding:
    """Try in a process of its own, so that this one stays as it is."""
    receive, send = multiprocessing.get_context("spawn").Pipe(duplex=False)
    process = multiprocessing.get_context("spawn").Process(target=_try_fifo, args=(send,))
    process.start()
    send.close()
    granted = bool(receive.recv()) if receive.poll(10.0) else False
    process.join()
    receive.close()
    if granted:
        return Finding("real time", True, "SCHED_FIFO is granted: the 500 Hz loop runs with little jitter")
    advice = {
        "linux": f"{_limit()}; ctr-station doctor --print limits | sudo tee /etc/security/limits.d/ctr-station.conf,"
        f" join the group dialout and log in again; for a service or a container {README}; or start with CAP_SYS_NICE,"
        " e.g. sudo setcap cap_sys_nice,cap_ipc_lock+ep on a copy of the interpreter",
        "darwin": "macOS has no SCHED_FIFO for programs; use Linux for experiments",
    }.get(sys.platform, "this system has no SCHED_FIFO; use Linux for experiments")
    return Finding("real time", False, f"SCHED_FIFO is refused: the loop still runs, with more jitter; {advice}")


def _try_fifo(send: Connection) -> None:
    send.send(ask_for_fifo())


def _punctuality() -> Finding:
    """A timer with nothing to do: the loop cannot be more punctual."""
    with TimerProbe(None) as probe:
        deadline = time.monotonic() + STARTS
        while not probe.figures()["ticks"] and time.monotonic() < deadline:
            time.sleep(0.05)
        probe.clear()
        time.sleep(WATCHED)
        seen = probe.figures()
    late = seen["late_us"]
    text = (
        f"a timer that does nothing woke {late['p50']:.0f} us late (median), {1e-3 * late['max']:.2g} ms at most, and"
        f" {seen['a_period_late']} of {seen['ticks']} times by 2 ms or more"
    )
    if not seen["a_period_late"]:
        return Finding("timer", bool(seen["ticks"]), text)
    return Finding("timer", False, f"{text}: the loop cannot be better; use a computer that is not shared with others")


def _memory() -> Finding:
    if may_lock_memory():
        return Finding("memory", True, "may be locked: the loop never waits for the disk")
    advice = "the same file sets memlock to unlimited; or start with CAP_IPC_LOCK"
    if sys.platform != "linux":
        advice = "this system has no such right for programs; use Linux for experiments"
    return Finding("memory", False, f"may not be locked: a computer short of memory makes the loop late; {advice}")


def _shared_memory() -> Finding:
    from multiprocessing.shared_memory import SharedMemory

    try:
        memory = SharedMemory(create=True, size=1 << 22)
    except OSError as error:
        return Finding("shared memory", False, f"none to be had ({error.strerror}); 4 MB are needed")
    memory.close()
    memory.unlink()
    return Finding("shared memory", True, "available for telemetry")


def _limit() -> str:
    import resource

    return f"the limit of priorities is {resource.getrlimit(resource.RLIMIT_RTPRIO)[1]} here"


def _serial_ports() -> Iterator[Finding]:
    from serial.tools.list_ports import comports

    ports = list(comports())
    named = ", ".join(f"{port.device} ({port.description})" for port in ports)
    yield Finding("serial ports", True, named or "none; the virtual lab needs none")
    yield from set_up(port.device for port in ports)
