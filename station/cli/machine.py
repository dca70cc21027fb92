"""Setup of a bench computer: check what is installed, and print the files to install from `station/machine/`."""

import getpass
import os
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

MACHINE_FOLDER = Path(__file__).parents[1] / "machine"
#: Names of the files in `station/machine/`, by the argument of `doctor --print`.
MACHINE_FILES = {
    "rules": "60-ctr-station.rules",
    "limits": "ctr-station.conf",
    "service": "ctr-station.service",
    "dockerfile": "Dockerfile",
}
UDEV_FOLDERS = (Path("/etc/udev/rules.d"), Path("/run/udev/rules.d"), Path("/usr/lib/udev/rules.d"))
SERVICE_FILE = Path("/etc/systemd/system/ctr-station.service")
USB_SERIAL = Path("/sys/bus/usb-serial/devices")
#: Real-time priority of the control loop (`request_fifo`).
PRIORITY = 50
README = str(MACHINE_FOLDER / "README.md")


class MachineFinding(NamedTuple):
    """Result of one check, with advice."""

    subject: str
    good: bool
    text: str


def machine_file(word: str) -> str:
    """Return the text of a file from `station/machine/`, adapted to this installation and the present user."""
    user = os.environ.get("SUDO_USER") or getpass.getuser()
    command = Path(sys.executable).with_name("ctr-station")
    text = (MACHINE_FOLDER / MACHINE_FILES[word]).read_text(encoding="utf-8")
    return text.replace("@user@", user).replace("@command@", str(command))


def setup_findings(ports: Iterable[str]) -> Iterator[MachineFinding]:
    """Check the access to serial ports, the udev rules of USB adapters, and the service; on Linux only."""
    if sys.platform != "linux":
        return
    yield rights(list(ports))
    yield rules(UDEV_FOLDERS, USB_SERIAL)
    yield service(SERVICE_FILE)


def rights(ports: list[str]) -> MachineFinding:
    """Check whether the present user may open the serial ports that exist, or any port by group membership."""
    closed = [port for port in ports if not os.access(port, os.R_OK | os.W_OK)]
    join = "join it: sudo usermod -aG dialout $USER, and log in again"
    if closed:
        return MachineFinding(
            "port rights", False, f"no access to {', '.join(closed)}; the ports belong to a group, {join}"
        )
    if ports:
        return MachineFinding("port rights", True, "every port may be opened")
    if os.geteuid() == 0 or "dialout" in _groups():
        return MachineFinding("port rights", True, "serial ports may be opened")
    return MachineFinding(
        "port rights", False, f"not in the group dialout, which owns serial ports; for a bench {join}"
    )


def _groups() -> set[str]:
    import grp

    return {group.gr_name for group in grp.getgrall() if group.gr_gid in {*os.getgroups(), os.getegid()}}


def rules(folders: Iterable[Path], adapters: Path) -> MachineFinding:
    """Check whether the udev rules for USB serial adapters are installed and active."""
    name = MACHINE_FILES["rules"]
    installed = next((folder / name for folder in folders if (folder / name).is_file()), None)
    slow = [timer.parent.name for timer in sorted(adapters.glob("*/latency_timer")) if int(timer.read_text() or 0) > 1]
    here = f"ctr-station doctor --print rules | sudo tee /etc/udev/rules.d/{name}"
    if slow:
        advice = "plug it in again" if installed else here
        return MachineFinding("udev rules", False, f"{', '.join(slow)} delays bytes by more than 1 ms; {advice}")
    if installed is None:
        needed = any(adapters.glob("*"))
        return MachineFinding("udev rules", not needed, f"none; for a bench {here}")
    if installed.read_text(encoding="utf-8", errors="replace") != machine_file("rules"):
        return MachineFinding("udev rules", False, f"{installed} differs from the file of this version; {here}")
    return MachineFinding("udev rules", True, str(installed))


def service(unit: Path) -> MachineFinding:
    """Check whether the service, if installed, can start this program with real-time scheduling."""
    if not unit.is_file():
        return MachineFinding("service", True, f"none: the station is started by hand ({README} has a service)")
    text = unit.read_text(encoding="utf-8", errors="replace")
    command = re.search(r"^ExecStart=(\S+)", text, re.MULTILINE)
    again = f"ctr-station doctor --print service | sudo tee {unit}"
    if command is None or not os.access(command[1], os.X_OK):
        problem = "has no ExecStart" if command is None else f"starts {command[1]}, which does not exist"
        return MachineFinding("service", False, f"{unit} {problem}; {again}")
    priority = re.search(r"^LimitRTPRIO=(\d+|infinity)$", text, re.MULTILINE)
    if priority is None or (priority[1] != "infinity" and int(priority[1]) < PRIORITY):
        return MachineFinding("service", False, f"{unit} lacks LimitRTPRIO=90, so no real-time scheduling; {again}")
    return MachineFinding("service", True, f"{unit} starts {command[1]}")
