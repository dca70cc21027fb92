"""Child processes of a process; a child that ends during the query is left out."""

from contextlib import suppress

import psutil


def has_ended(process: psutil.Process) -> bool:
    """Return whether a process has ended; its parent may collect it at any time."""
    with suppress(psutil.NoSuchProcess):
        return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    return True


def children(parent: int | None = None, name: str = "", word: str = "") -> list[psutil.Process]:
    """Return the child processes with a name, or with a word in their command line.

    Args:
        parent: process id; None: this process.
        name: name of the process as the system lists it; empty: any.
        word: part of the command line; empty: any.
    """
    found: list[psutil.Process] = []
    for child in psutil.Process(parent).children():
        with suppress(psutil.NoSuchProcess):  # ended, or ended and not yet collected by its parent
            if (not name or child.name() == name) and (not word or word in " ".join(child.cmdline())):
                found.append(child)
    return found
