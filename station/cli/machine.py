"""A bench's computer: what was set up on it for the station, and the files for what was not (`station/machine/`)."""

import getpass
import os
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(__file__).parents[1] / "machine"
#: By the word that `doctor --print` takes.
FILES = {
    "rules": "60-ctr-station.rules",
    "limits": "ctr-station.conf",
    "service": "ctr-station.service",
    "dockerfile": "Dockerfile",
}
RULES = (Path("/etc/udev/rules.d"), Path("/run/udev/rules.d"), Path("/usr/lib/udev/rules.d"))
SERVICE = Path("/etc/systemd/system/ctr-station.service")
USB_SERIAL = Path("/sys/bus/usb-serial/devices")
#: Of the control loop (`ask_for_fifo`).
PRIORITY = 50
README = "station/machine/README.md"


class Finding(NamedTuple):
    """One thing that matters, and what to do about it."""

    subject: str
    good: bool
    text: str


def printed(word: str) -> str:
    """The file, made out for this installation and whoever asks."""
    user = os.environ.get("SUDO_USER") or getpass.getuser()
    command = Path(sys.executable).with_name("ctr-station")
    text = (FOLDER / FILES[word]).read_text(encoding="utf-8")
    return text.replace("@user@", user).replace("@command@", str(command))


def set_up(ports: Iterable[str]) -> Iterator[Finding]:
    """Rights to these serial ports, rules for those on USB, and the service; on Linux only."""
    if sys.platform != "linux":
        return
    yield rights(list(ports))
    yield rules(RULES, USB_SERIAL)
    yield service(SERVICE)


def rights(ports: list[str]) -> Finding:
    """Whether whoever asks may open serial ports: those that are there, or any by group."""
    closed = [port for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    join = "join it: sudo usermod -aG dialout $USER, and log in again"
    if closed:
        return Finding("port rights", False, f"{', '.join(closed)} may not be opened; ports are of a group, {join}")
    if ports:
        return Finding("port rights", True, "every port may be opened")
    if os.geteuid() == 0 or "dialout" in _groups():
        return Finding("port rights", True, "serial ports may be opened")
    return Finding("port rights", False, f"not in the group dialout, whose serial ports are; for a bench {join}")


def _groups() -> set[str]:
    import grp

    return {group.gr_name for group in grp.getgrall() if group.gr_gid in {*os.getgroups(), os.getegid()}}


def rules(folders: Iterable[Path], adapters: Path) -> Finding:
    """Whether the rules for serial lines on USB are there, and heeded by the adapters that are."""
    name = FILES["rules"]
    installed = next((folder / name for folder in folders if (folder / name).is_file()), None)
    slow = [timer.parent.name for timer in sorted(adapters.glob("*/latency_timer")) if int(timer.read_text() or 0) > 1]
    here = f"ctr-station doctor --print rules | sudo tee /etc/udev/rules.d/{name}"
    if slow:
        told = "plug it in again" if installed else here
        return Finding("udev rules", False, f"{', '.join(slow)} hands over what it heard late; {told}")
    if installed is None:
        needed = any(adapters.glob("*"))
        return Finding("udev rules", not needed, f"none; for a bench {here}")
    if installed.read_text(encoding="utf-8", errors="replace") != printed("rules"):
        return Finding("udev rules", False, f"{installed} is not what this version has; {here}")
    return Finding("udev rules", True, str(installed))


def service(unit: Path) -> Finding:
    """Whether the service, where there is one, can start this program and gets its rights."""
    if not unit.is_file():
        return Finding("service", True, f"none: started by hand ({README} has one)")
    text = unit.read_text(encoding="utf-8", errors="replace")
    command = re.search(r"^ExecStart=(\S+)", text, re.MULTILINE)
    again = f"ctr-station doctor --print service | sudo tee {unit}"
    if command is None or not os.access(command[1], os.X_OK):
        told = "starts nothing" if command is None else f"starts {command[1]}, which is not there"
        return Finding("service", False, f"{unit} {told}; {again}")
    priority = re.search(r"^LimitRTPRIO=(\d+|infinity)$", text, re.MULTILINE)
    if priority is None or (priority[1] != "infinity" and int(priority[1]) < PRIORITY):
        return Finding("service", False, f"{unit} grants no real-time scheduling (LimitRTPRIO=90); {again}")
    return Finding("service", True, f"{unit} starts {command[1]}")
