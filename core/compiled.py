"""One way to compile: Numba with a cache on disk, typed like the function it compiles.

`error_model="numpy"` drops division checks inside loops. The fast-math flags let the compiler
fuse and reorder but keep NaN and infinity meaningful, because the loop checks for them.
"""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numba  # pyright: ignore[reportMissingTypeStubs]

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on first call; later processes load it from the cache."""
    njit = cast(Any, numba).njit
    jit = njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
    return cast(Callable[P, R], jit(function))
