"""One way to compile: Numba with a cache on disk, typed like the function it compiles.

The cache knows the sources of what a function names: one that calls a function or is given a type of another file is
compiled anew when that file has changed.

`error_model="numpy"` drops division checks inside loops. The fast-math flags let the compiler
fuse and reorder but keep NaN and infinity meaningful, because the loop checks for them.
"""

import hashlib
import inspect
import sys
from collections.abc import Callable
from functools import cache
from typing import Any, ParamSpec, TypeVar, cast

import numba  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numba.core.caching import IndexDataCacheFile  # pyright: ignore[reportMissingTypeStubs]
from numba.core.dispatcher import Dispatcher  # pyright: ignore[reportMissingTypeStubs]
from numba.cpython.unsafe import tuple as numba_tuple  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}

#: The modules that each compiled function is made of.
_SOURCES: dict[Any, frozenset[str]] = {}

#: `replaced(numbers, index, value)`: the tuple with one number changed. Compiled code only. Tuples of
#: known length live in registers; an array would be memory that a loop over columns cannot prove its own.
replaced = cast(Callable[[tuple[float, ...], int, float], tuple[float, ...]], cast(Any, numba_tuple).tuple_setitem)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on first call; later processes load it from the cache."""
    return _compiled(function)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """The same for a piece of a loop's body, so that the loop around it is still vectorised."""
    return _compiled(function, forceinline=True)


def unlocked(function: Callable[P, R]) -> Callable[P, R]:
    """The same for a function that runs without Python's lock, so that threads call it side by side."""
    return _compiled(function, nogil=True)


def _compiled(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    made = cast(Any, numba).njit(**options, **_OPTIONS)(function)
    sources, values = _goes_into(function)
    _SOURCES[made] = sources
    digest = hashlib.sha256("".join((*map(_content, sorted(sources)), *values)).encode()).hexdigest()[:16]
    # Numba keeps machine code until the function's own file changes, and would go on with that of a function which
    # calls one, or is given a type, of another file that has changed: with numbers at their old places, for instance.
    kept = made._cache
    kept._cache_file = IndexDataCacheFile(kept.cache_path, f"{kept._impl.filename_base}-{digest}", digest)
    return made


def _goes_into(function: Callable[..., Any]) -> tuple[frozenset[str], list[str]]:
    """The modules of all the code that a function is compiled from, and the constants that it names."""
    code, here = function.__code__, function.__globals__
    sources, values = {function.__module__}, list[str]()
    named: list[Any] = [*map(here.get, code.co_names), *function.__annotations__.values()]
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
    """Digest of its source."""
    return hashlib.sha256(inspect.getsource(sys.modules[module]).encode()).hexdigest()


@compiled
def copy(numbers: NDArray[np.floating[Any]], out: NDArray[np.float64]) -> None:
    """`out[:] = numbers` for vectors in compiled code: the compiler takes two seconds for numpy's, for its message."""
    for i in range(numbers.shape[0]):
        out[i] = numbers[i]
