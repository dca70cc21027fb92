"""Checks of values that custom code returns: control loops, limits, loads and drivers from outside the project."""

import math
from collections.abc import Callable
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from core.errors import ContractError

Array = NDArray[np.float64]


def name_of(custom: Any) -> str:
    """Return the name of custom code for messages: the function's name, or the name of the object's class."""
    return str(getattr(custom, "__name__", type(custom).__name__))


def result_of(who: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function of the custom code named `who` and return its result.

    Raises:
        ContractError: the custom function raised an exception; the text names `who` and the exception.

    """
    try:
        return function(*arguments)
    except (Exception, SystemExit) as error:
        raise ContractError(f"{who} raised {type(error).__name__}: {error}") from error


def reset_state(who: str, custom: Any) -> None:
    """Call the method `reset` of the custom code named `who`, if it has one.

    Raises:
        ContractError: the method raised.

    """
    if (reset := getattr(custom, "reset", None)) is not None:
        result_of(f"{who}: reset", reset)


def pair(who: str, value: Any, expected: str) -> tuple[Any, Any]:
    """Return both elements of `value`, the tuple that the custom code named `who` returned.

    Raises:
        ContractError: `value` is not a tuple of two elements; the text states what is `expected`.

    """
    if not isinstance(value, tuple) or len(cast("tuple[Any, ...]", value)) != 2:
        raise ContractError(f"{who} returned a {type(cast(Any, value)).__name__}; it must return {expected}")
    return cast("tuple[Any, Any]", value)


def numbers(who: str, what: str, value: Any, shape: tuple[int, ...], unit: str, *, finite: bool = True) -> Array:
    """Return a copy of an array that custom code returned, with the shape and type that compiled code needs.

    `value` is that array. Error texts name the custom code (`who`) and the quantity (`what`).

    Raises:
        ContractError: `value` has the wrong shape, is not numeric, or contains NaN or infinity although `finite` is
        True.

    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.shape == shape:
        # Fast path for the usual case: numpy's functions take longer for a few numbers.
        copied: Array = value.copy()
        if not finite or all(map(math.isfinite, copied.ravel().tolist())):
            return copied
    expected = f"it must be {'finite' if finite else 'real'} numbers [{unit}] of shape {shape}"
    try:
        given = np.asarray(value)
    except (Exception, SystemExit) as error:
        raise ContractError(f"{who}: {what} is not an array ({type(error).__name__}: {error}); {expected}") from error
    if given.shape != shape or given.dtype.kind not in "fiu":
        raise ContractError(f"{who}: {what} has shape {given.shape} and type {given.dtype}; {expected}")
    with np.errstate(over="ignore"):
        found = np.array(given, dtype=np.float64, order="C")
    if finite and not np.isfinite(found).all():
        raise ContractError(f"{who}: {what} is {found.tolist()}; {expected}")
    return found
