"""Real-time rights of a process, checked from another process."""

import os
import signal
import subprocess
import sys

import pytest

from station.control.realtime import Life, life
from tests.harness.root import ROOT
from tests.harness.waiting import NET, until

SCRIPT = """
import os, sys, gc
from pathlib import Path
from station.control.realtime import last_core, move_off_core, request_realtime, set_process_name
left = last_core()
move_off_core(left, [os.getpid()])
others = sorted(os.sched_getaffinity(0))
granted = request_realtime(fifo=True, core=left)
set_process_name("ctr-tested")
locked = next(l for l in Path("/proc/self/status").read_text().splitlines() if l.startswith("VmLck"))
child = os.fork()
if child == 0:
    os._exit(os.sched_getscheduler(0) == os.SCHED_OTHER)
inherits = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 1
print(repr({
    "left": left, "others": others, "mine": sorted(os.sched_getaffinity(0)), "fifo": granted.fifo,
    "refused": granted.refused, "locked": int(locked.split()[1]), "scheduler": os.sched_getscheduler(0),
    "gc": gc.isenabled(), "name": Path("/proc/self/comm").read_text().strip(), "inherits": inherits,
}))
"""


def run(*before: str, **environment: str) -> dict:
    done = subprocess.run(
        [*before, sys.executable, "-c", SCRIPT], capture_output=True, text=True, timeout=NET,
        env={**os.environ, **environment}, cwd=ROOT, check=True,
    )  # fmt: skip
    return eval(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux")
def test_granted_real_time_rights_are_in_effect_and_refused_rights_are_reported() -> None:
    got = run()
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) > 1:
        assert got["left"] == cores[-1]
        assert got["others"] == cores[:-1]
        assert got["mine"] == [cores[-1]]
    assert got["fifo"] == (got["scheduler"] & 0xFF == os.SCHED_FIFO)
    assert got["fifo"] != any("SCHED_FIFO is refused" in text for text in got["refused"])
    assert (got["locked"] > 0) != any("memory cannot be locked" in text for text in got["refused"])
    assert got["gc"] is False
    assert got["name"] == "ctr-tested"
    assert got["inherits"] is False


@pytest.mark.skipif(sys.platform != "linux" or os.geteuid() != 0, reason="takes rights away, which only root can")
def test_missing_real_time_rights_are_reported_in_plain_words() -> None:
    rights = "--bounding-set=-sys_nice,-ipc_lock,-sys_resource"
    got = run("setpriv", rights, "--inh-caps=-all", "prlimit", "--rtprio=0:0", "--memlock=65536:65536")
    assert got["fifo"] is False
    assert got["locked"] == 0
    assert [text.split(":")[0] for text in got["refused"]] == ["memory cannot be locked", "SCHED_FIFO is refused"]
    assert all("ctr-station doctor" in text for text in got["refused"])


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux")
def test_suspended_and_killed_processes_are_told_from_running_ones_before_they_are_reaped() -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as process:
        assert life(process.pid) is Life.RUNS
        process.send_signal(signal.SIGSTOP)
        until(lambda: life(process.pid) is Life.SUSPENDED)
        process.send_signal(signal.SIGCONT)
        until(lambda: life(process.pid) is Life.RUNS)
        process.kill()
        until(lambda: life(process.pid) is Life.ENDED)
    assert life(process.pid) is Life.ENDED  # no process has this process ID any more
