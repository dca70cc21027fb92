"""Linear algebra in one thread: for matrices as small as ours a second one waits for more than it computes.

Its libraries read the environment when they are loaded, in this process or in those that it starts. Idle threads also
hold up the end of a process that is killed: it lets go of its pipes only when the last of them has ended, which takes a
tenth of a second on a busy computer.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager

#: How many threads libraries start by themselves.
NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread_each() -> None:
    """From now on, unless whoever started this process has said otherwise."""
    for name in NAMES:
        os.environ.setdefault(name, "1")


@contextmanager
def one_thread_meanwhile() -> Iterator[None]:
    """For processes that are started meanwhile, whatever has been said."""
    before = {name: os.environ.get(name) for name in NAMES}
    os.environ.update(dict.fromkeys(NAMES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
