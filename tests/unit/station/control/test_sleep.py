"""Sleep of the computer is prevented by a process that ends with the station, and is detected by two clocks."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from station.cli.doctor import _sleep
from station.control import sleep
from station.control.sleep import Awake, SleepDetector, time_asleep
from tests.harness.waiting import until

HOLDS = 'echo "$$ $*" > "{file}.new"; mv "{file}.new" "{file}"; while test $# -gt 1; do shift; done; exec "$1"'


@pytest.fixture
def keeper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Path]:
    """Install a `systemd-inhibit` with a body; return the file for its process ID and arguments."""

    def install(body: str) -> Path:
        file, program = tmp_path / "called", tmp_path / "systemd-inhibit"
        program.write_text(f"#!/bin/sh\n{body.format(file=file)}\n", encoding="utf-8")
        program.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
        return file

    return install


def ended(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


@pytest.mark.parametrize(("lid", "what"), [(True, "sleep:idle:handle-lid-switch"), (False, "sleep:idle")])
def test_sleep_is_prevented_until_close(keeper, lid, what):
    called = keeper(HOLDS)
    awake = Awake(lid=lid)
    until(called.exists)
    pid, *arguments = called.read_text(encoding="utf-8").split()
    assert f"--what={what}" in arguments
    assert "--mode=block" in arguments
    assert awake.refused == ""
    assert not ended(int(pid))
    awake.close()
    assert ended(int(pid))


def test_sleep_is_permitted_again_after_the_station_process_is_killed(keeper):
    called = keeper(HOLDS)
    station = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "from station.control.sleep import Awake; a = Awake(lid=True); import time; time.sleep(300)",
        ]
    )
    try:
        until(called.exists)
    finally:
        station.send_signal(signal.SIGKILL)
        station.wait()
    until(lambda: ended(int(called.read_text(encoding="utf-8").split()[0])))


def test_a_refusal_is_named_in_one_line(keeper):
    keeper("echo 'Failed to inhibit:' >&2; echo 'Access denied' >&2; exit 1")
    awake = Awake(lid=True)
    assert until(lambda: awake.refused) == "Failed to inhibit: Access denied"
    awake.close()
    assert "(Failed to inhibit: Access denied): turn sleep off" in _sleep().text
    assert not _sleep().good


def test_doctor_tries_to_prevent_sleep(keeper):
    keeper(HOLDS)
    assert _sleep().good


def test_no_keeper_is_needed_where_sleep_is_masked(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sleep, "MASKED", tmp_path / "sleep.target")
    assert Awake(lid=True).refused
    (tmp_path / "sleep.target").symlink_to("/dev/null")
    assert Awake(lid=True).refused == ""
    assert _sleep().text == "it is turned off"


def test_a_missing_keeper_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert Awake(lid=True).refused == "systemd-inhibit: No such file or directory"
    assert "systemd-inhibit" in _sleep().text


def test_sleep_is_found_once_and_short_differences_of_the_clocks_are_ignored(monkeypatch):
    clocks = {time.CLOCK_BOOTTIME: 5000.0, time.CLOCK_MONOTONIC: 1000.0}
    monkeypatch.setattr(time, "clock_gettime", clocks.__getitem__)
    detector, found = SleepDetector(), []
    for passed, asleep in ((0.002, 0.0), (0.002, 12.0), (0.002, 0.0), (3600.0, 0.0), (0.002, 0.1), (0.002, 0.3)):
        clocks[time.CLOCK_MONOTONIC] += passed
        clocks[time.CLOCK_BOOTTIME] += passed + asleep
        found.append(round(detector.check(), 6))
    assert found == [0.0, 12.0, 0.0, 0.0, 0.0, 0.4]


def test_this_computer_counts_its_sleep():
    first = time_asleep()
    assert first > -1.0
    assert abs(time_asleep() - first) < 60.0
