"""One way to compile: Numba with a cache on disk, typed like the function it compiles.

`error_model="numpy"` drops division checks inside loops. The fast-math flags let the compiler
fuse and reorder but keep NaN and infinity meaningful, because the loop checks for them.
"""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
from numba.cpython.unsafe import tuple as numba_tuple  # pyright: ignore[reportMissingTypeStubs]
from numpy.typing import NDArray

P = ParamSpec("P")
R = TypeVar("R")

_OPTIONS: dict[str, Any] = {
    "cache": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}

#: `replaced(numbers, index, value)`: the tuple with one number changed. Compiled code only. Tuples of
#: known length live in registers; an array would be memory that a loop over columns cannot prove its own.
replaced = cast(Callable[[tuple[float, ...], int, float], tuple[float, ...]], cast(Any, numba_tuple).tuple_setitem)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on first call; later processes load it from the cache."""
    return cast(Callable[P, R], cast(Any, numba).njit(**_OPTIONS)(function))


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """The same for a piece of a loop's body, so that the loop around it is still vectorised."""
    return cast(Callable[P, R], cast(Any, numba).njit(forceinline=True, **_OPTIONS)(function))


@compiled
def copy(numbers: NDArray[np.floating[Any]], out: NDArray[np.float64]) -> None:
    """`out[:] = numbers` for vectors in compiled code: the compiler takes two seconds for numpy's, for its message."""
    for i in range(numbers.shape[0]):
        out[i] = numbers[i]
