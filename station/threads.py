"""Limit libraries for linear algebra to one thread: for small matrices one thread is faster than several.

A library reads its number of threads from the environment when it is loaded, in this process or in a child process.
Idle threads also delay the end of a killed process: its pipes close only when the last thread has ended. On a busy
computer this delay is a tenth of a second.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

#: Environment variables from which libraries read the number of their threads.
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def limit_to_one_thread() -> None:
    """Limit libraries that are loaded from now on to one thread, unless the environment already sets a number."""
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, "1")


@contextmanager
def one_thread_during() -> Iterator[None]:
    """Limit libraries to one thread in processes that the block starts, even if the environment sets another number."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
