"""A virtual lab that a thread of the test advances."""

import contextlib
import threading
from collections.abc import Iterator

from station.lab.lab_server import LabServer


@contextlib.contextmanager
def running(lab: LabServer) -> Iterator[LabServer]:
    """Advance a virtual lab in real time by a thread."""
    over = threading.Event()
    thread = threading.Thread(target=lab.run, args=(over.is_set,))
    thread.start()
    try:
        yield lab
    finally:
        over.set()
        thread.join()
        lab.close()
