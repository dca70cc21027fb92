"""Ways in which a station's terminal, parent or processes end or are suspended: functions of a `MortalStation`."""

import signal
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from tests.harness.mortal_station import HELPERS, MortalStation

Ending = Callable[[MortalStation], None]
PROCESSES = ("station", *HELPERS)
#: Signals that do nothing to a program that has not asked for them, or that Python or the station ignores.
HARMLESS = {
    signal.SIGCHLD, signal.SIGCONT, signal.SIGURG, signal.SIGWINCH, signal.SIGPIPE, signal.SIGXFSZ, signal.SIGTSTP,
    signal.SIGTTIN, signal.SIGTTOU,
}  # fmt: skip
#: Signals that end a program unless it handles them; of the real-time signals only the first and the last.
DEADLY = [
    number for number in signal.Signals if number not in HARMLESS | {signal.SIGKILL, signal.SIGSTOP}
]  # fmt: skip


def _but(name: str) -> list[str]:
    return [other for other in PROCESSES if other != name]


def _close_terminal(station: MortalStation) -> None:
    station.close_terminal()


def _drop_session(station: MortalStation) -> None:
    """Do what a lost connection to another computer does: the terminal hangs up after its shell has ended."""
    station.shell.kill()
    station.close_terminal()


def _kill_parent(station: MortalStation) -> None:
    station.parent.kill()


def _kill_shell(station: MortalStation) -> None:
    station.shell.kill()


def _end_service(station: MortalStation) -> None:
    """Do what a service manager does first: SIGTERM to every process of the station."""
    station.signal(signal.SIGTERM, *PROCESSES)


def _log_out(station: MortalStation) -> None:
    """Do what a login manager does first: SIGTERM and SIGHUP to every process of the session's user."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        station.signal(number, *PROCESSES)


def _run_out_of_memory(station: MortalStation) -> None:
    """Do what Linux does without free memory: kill the process that the system names first."""
    scores = {name: int(Path(f"/proc/{p.pid}/oom_score").read_text()) for name, p in station.processes.items()}
    station.signal(signal.SIGKILL, max(scores, key=scores.__getitem__))


#: Endings of a calibration, of which only the process that plans and computes is left.
OF_CALIBRATIONS: Mapping[str, Ending] = {
    f"{number.name} to all but calibrate": lambda station, number=number: station.signal(number, *PROCESSES)
    for number in (signal.SIGKILL, signal.SIGSTOP)
}
ENDINGS: Mapping[str, Ending] = {
    "terminal closed": _close_terminal,
    "session dropped": _drop_session,
    "Ctrl-C": lambda station: station.press(b"\x03"),
    "Ctrl-backslash": lambda station: station.press(b"\x1c"),
    "parent killed": _kill_parent,
    "shell killed": _kill_shell,
    "service ended": _end_service,
    "logout": _log_out,
    "memory killer": _run_out_of_memory,
    **{f"{n.name} to the group": partial(MortalStation.signal_group, number=n) for n in DEADLY},
    **{
        f"{number.name} to {whom}": lambda station, number=number, names=names: station.signal(number, *names)
        for number in (signal.SIGKILL, signal.SIGSTOP)
        for name in PROCESSES
        for whom, names in ((name, [name]), (f"all but {name}", _but(name)))
    },
    **OF_CALIBRATIONS,
}
