"""Sleep of the computer: prevent it while the station runs, and detect it afterwards.

While a computer sleeps, no program can stop the stages, which continue at their last velocity.
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

#: Shortest sleep that counts [s]. Between the readings of two clocks the system may run other programs.
SHORTEST_SLEEP_S = 0.25
#: Readings of the clocks from which the time asleep before the start is taken; each may be too small, none too large.
FIRST_READINGS = 5
#: Time for the keeper to end [s].
END_S = 1.0
#: Link to /dev/null after `systemctl mask`: this computer never sleeps.
MASKED = Path("/etc/systemd/system/sleep.target")
#: Advice where sleep cannot be prevented.
TURN_OFF_SLEEP = "turn sleep off in the settings of this computer; with systemd: sudo systemctl mask sleep.target"


def time_asleep() -> float:
    """Return how long this computer has slept since its start [s]; 0 if the system does not count this.

    The clock that advances during sleep is read first, so that a delay between both readings makes the result smaller.
    """
    if sys.platform == "linux":
        return time.clock_gettime(time.CLOCK_BOOTTIME) - time.clock_gettime(time.CLOCK_MONOTONIC)
    if sys.platform == "darwin":
        return time.clock_gettime(time.CLOCK_MONOTONIC) - time.clock_gettime(time.CLOCK_UPTIME_RAW)
    return 0.0


class SleepDetector:
    """Detector of sleep since the last call of `check`."""

    def __init__(self) -> None:
        self._known = max(time_asleep() for _ in range(FIRST_READINGS))  # time asleep that was reported [s]

    def check(self) -> float:
        """Return how long the computer has slept since the last result above 0 [s]; 0 below `SHORTEST_SLEEP_S`."""
        slept = time_asleep() - self._known
        if slept < SHORTEST_SLEEP_S:
            return 0.0
        self._known += slept
        return slept


def never_sleeps() -> bool:
    """Return whether sleep is turned off for all programs of this computer, as far as it is known."""
    return MASKED.is_symlink() and MASKED.readlink() == Path(os.devnull)


def keeper_command(*, lid: bool) -> Sequence[str]:
    """Return the command that keeps this computer awake until its standard input ends.

    Args:
        lid: also stay awake when the lid of a laptop is closed, because stages could move.
    """
    if sys.platform == "darwin":
        return ("caffeinate", "-i", "-s", "cat")
    what = "sleep:idle:handle-lid-switch" if lid else "sleep:idle"
    why = "--why=the station of a robot is running"
    return ("systemd-inhibit", f"--what={what}", "--who=ctr-station", why, "--mode=block", "cat")


class Awake:
    """Keeper that prevents sleep from its creation until `close`, or until this process ends in any way."""

    def __init__(self, *, lid: bool) -> None:
        self._keeper: subprocess.Popen[str] | None = None
        self._refused, self._asking = "", threading.Lock()  # each request for the status may ask, in its own thread
        pipe = subprocess.PIPE
        try:
            # In a separate session, signals from the terminal do not end the keeper before the station has ended.
            self._keeper = subprocess.Popen(  # noqa: S603 - a fixed command
                keeper_command(lid=lid), stdin=pipe, stdout=subprocess.DEVNULL, stderr=pipe, text=True,
                start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            self._refused = f"{error.filename}: {error.strerror}"

    @property
    def refused(self) -> str:
        """Why the computer may sleep, in one line; empty while sleep is prevented, as far as it is known."""
        if never_sleeps():
            return ""
        keeper = self._keeper
        with self._asking:
            if keeper is not None and keeper.poll() is not None and not self._refused:
                answer = " ".join(keeper.communicate()[1].split())
                self._refused = answer or f"its keeper ended with status {keeper.returncode}"
            return self._refused

    def close(self) -> None:
        """Permit sleep again."""
        if self._keeper is None:
            return
        with self._asking:
            try:
                self._keeper.communicate(timeout=END_S)
            except subprocess.TimeoutExpired:
                self._keeper.kill()
