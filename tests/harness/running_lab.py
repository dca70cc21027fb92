"""The open lab in a thread of the test."""

import contextlib
import threading
from collections.abc import Iterator

from station.lab.lab_server import LabServer


@contextlib.contextmanager
def running(lab: LabServer) -> Iterator[LabServer]:
    """A lab that a thread keeps in real time."""
    over = threading.Event()
    thread = threading.Thread(target=lab.run, args=(over.is_set,))
    thread.start()
    try:
        yield lab
    finally:
        over.set()
        thread.join()
        lab.close()
