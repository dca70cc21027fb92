"""Decorators that compile functions with Numba, cache the machine code on disk and keep the type annotations.

The cache key of a function includes the sources of all functions and types that the function names. A function is
therefore also recompiled when another file, whose functions or types it uses, has changed. If several processes need a
function at the same time, one of them compiles it, and the others wait and load it.

`error_model="numpy"` drops division checks inside loops. The fast-math flags let the compiler fuse and reorder
operations. The chosen flags keep NaN and infinity meaningful, because the control loop checks for them.
"""

import fcntl
import hashlib
import inspect
import logging
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from functools import cache
from typing import Any, ParamSpec, TypeVar, cast

import numba  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numba.core import event  # pyright: ignore[reportMissingTypeStubs]
from numba.core.caching import IndexDataCacheFile  # pyright: ignore[reportMissingTypeStubs]
from numba.core.compiler_lock import global_compiler_lock  # pyright: ignore[reportMissingTypeStubs]
from numba.core.dispatcher import Dispatcher  # pyright: ignore[reportMissingTypeStubs]
from numba.cpython.unsafe import tuple as numba_tuple  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import NDArray

_LOG = logging.getLogger(__name__)

#: Rows and columns of each part of a packed array.
Shapes = tuple[tuple[int, int], ...]

P = ParamSpec("P")
R = TypeVar("R")

_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"}}

#: Names of the modules that each compiled function depends on; their sources are part of the cache key.
_SOURCES: dict[Any, frozenset[str]] = {}

#: Names of the functions whose machine code this process has compiled or loaded from the cache, in this order. A
#: function appears once for each combination of argument types.
PREPARED: list[str] = []

#: `replaced(numbers, index, value)` returns the tuple with one number changed. It works in compiled code only. Compiled
#: code uses tuples of known length because they are kept in registers. An array's memory might overlap another array's
#: memory, and the compiler could then not vectorise the loop.
replaced = cast(Callable[[tuple[float, ...], int, float], tuple[float, ...]], cast(Any, numba_tuple).tuple_setitem)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on first call; later processes load it from the cache."""
    return _compiled(function)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function and inline it into its callers, so that a loop that calls it can still be vectorised."""
    return _compiled(function, forceinline=True)


def merged(function: Callable[P, R]) -> Callable[P, R]:
    """Copy a short function into its callers before their compilation; it is never compiled by itself.

    Otherwise Numba would compile it again for each combination of constant arguments, which takes 0.2 s each time.
    """
    return _compiled(function, inline="always")


def unlocked(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function that releases Python's lock (GIL), so that threads can call it concurrently."""
    return _compiled(function, nogil=True)


class _Compilations(event.Listener):
    """Logs the name of each function when its compilation starts; code that is read from the disk is not logged."""

    def on_start(self, event: Any) -> None:
        _LOG.info("compiling %s", event.data["dispatcher"].py_func.__qualname__)

    def on_end(self, event: Any) -> None:
        pass


cast(Any, event).register("numba:compile", _Compilations())


def _compiled(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    made = cast(Any, numba).njit(**options, **_OPTIONS)(function)
    sources, values = _dependencies(function)
    _SOURCES[made] = sources
    contents = (function.__qualname__, *map(_content, sorted(sources)), *values)
    digest = hashlib.sha256("".join(contents).encode()).hexdigest()[:16]
    # Numba reuses machine code until the function's own file changes. It would also reuse the code after a called
    # function or a used type in another file has changed, for instance with array indices that are no longer valid. The
    # digest in the file name prevents that.
    disk_cache = made._cache
    disk_cache._cache_file = IndexDataCacheFile(
        disk_cache.cache_path, f"{disk_cache._impl.filename_base}-{digest}", digest
    )
    compile_now, locator, number = made.compile, disk_cache._impl.locator, int(digest[:15], 16)

    def compile_once(signature: Any) -> Any:
        # Take the compiler's lock first: in the other order, two threads could wait for each other.
        with cast(Any, global_compiler_lock), _locked(locator, number):
            known = len(made.overloads)
            code = compile_now(signature)
            PREPARED.extend((function.__qualname__,) * (len(made.overloads) - known))
            return code

    made.compile = compile_once
    return made


@contextmanager
def _locked(locator: Any, number: int) -> Generator[None]:
    """Wait until no other process compiles the function with this number, and keep other processes from compiling it.

    Functions are locked in the order of their calls, so no two processes wait for each other. Without write access to
    the folder of compiled code, which `locator` finds, or on a drive without locks, processes may compile twice.
    """
    descriptor = None
    with suppress(OSError):
        locator.ensure_cache_path()
        descriptor = _lock_file(f"{locator.get_cache_path()}/compiling.lock")
        fcntl.lockf(descriptor, fcntl.LOCK_EX, 1, number)
    try:
        yield
    finally:
        if descriptor is not None:
            with suppress(OSError):
                fcntl.lockf(descriptor, fcntl.LOCK_UN, 1, number)


@cache
def _lock_file(path: str) -> int:
    """Open a file for locks and return its descriptor.

    The descriptor stays open until the process ends, because closing it would release all its locks.
    """
    with open(path, "a", encoding="utf-8") as file:  # noqa: PTH123 - core does not import pathlib
        return fcntl.fcntl(file, fcntl.F_DUPFD_CLOEXEC, 0)


def _dependencies(function: Callable[..., Any]) -> tuple[frozenset[str], list[str]]:
    """Return the modules whose source code a function is compiled from, and the values of the constants it names."""
    code, names = function.__code__, function.__globals__
    sources, values = {function.__module__}, list[str]()
    named: list[Any] = [*map(names.get, code.co_names), *function.__annotations__.values()]
    for one in named:
        if isinstance(one, Dispatcher):
            sources |= _SOURCES.get(one, frozenset())
        elif isinstance(one, type) and hasattr(one, "_fields"):
            sources.add(one.__module__)
        elif isinstance(one, int | float | str | tuple):
            values.append(repr(cast(object, one)))
    return frozenset(sources), values


@cache
def _content(module: str) -> str:
    """Return the digest of the source code of a module."""
    return hashlib.sha256(inspect.getsource(sys.modules[module]).encode()).hexdigest()


@compiled
def copy(numbers: NDArray[np.floating[Any]], out: NDArray[np.float64]) -> None:
    """Copy a vector: `out[:] = numbers`, in a loop because compiling numpy's assignment takes two seconds."""
    for i in range(numbers.shape[0]):
        out[i] = numbers[i]


@merged
def part(numbers: NDArray[np.float64], shapes: Shapes, index: int) -> NDArray[np.float64]:
    """Return part number `index` of a packed array as a view (rows, columns); the parts have the order of `shapes`.

    Arrays are packed into one because every array argument adds time to the call of a compiled function.
    """
    start = 0
    for i in range(index):
        start += shapes[i][0] * shapes[i][1]
    rows, columns = shapes[index]
    return numbers[start : start + rows * columns].reshape(rows, columns)


def packed_size(shapes: Shapes) -> int:
    """Return the number of values of a packed array."""
    return sum(rows * columns for rows, columns in shapes)
