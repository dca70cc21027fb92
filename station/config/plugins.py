"""Code of other packages: found by the name of its entry point, loaded once, and checked.

A package offers a control loop, a task, a limit or a load with an entry point of the group in `GROUPS`. The entry point
is a callable `make(setup)`; `setup` is a `Setup`. Files, requests and the page then use its name.
"""

import pickle
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, NamedTuple

from core.contract import result_of
from core.control.controllers import PositionMode
from core.errors import CtrError
from core.robot.robot import Robot
from station.config.strict import ConfigError

Kind = Literal["outer_loops", "inner_loops", "tasks", "limits", "loads"]
#: Methods that an object of each kind must have.
METHODS: dict[Kind, tuple[str, ...]] = {
    "outer_loops": ("tip_velocity",),
    "inner_loops": ("__call__",),
    "tasks": ("rows",),
    "limits": ("names", "rows", "check"),
    "loads": ("force",),
}
#: Group of entry points of each kind.
GROUPS: dict[Kind, str] = {kind: f"ctr_station.{kind}" for kind in METHODS}


class Setup(NamedTuple):
    """Argument of an entry point's `make`, from which it makes the installed code."""

    options: Mapping[str, Any]  #: keys of the installed code in the file
    robot: Robot | None = None  #: robot of the station; None for a load
    dt: float = 0.0  #: time between two ticks [s]; 0 for a load
    gains: PositionMode = PositionMode(2.5, 2.5)  #: for a loop: `k1`, `k2` and `feedforward` of the controller


def installed(kind: Kind) -> tuple[str, ...]:
    """Return the names of the installed code of a kind."""
    return tuple(sorted({point.name for point in entry_points(group=GROUPS[kind])}))


def preload() -> None:
    """Import all installed code, so that no tick waits for an import; code that fails here is refused at its use."""
    for group in GROUPS.values():
        for point in entry_points(group=group):
            with suppress(Exception, SystemExit):
                point.load()


def made(kind: Kind, name: str, key: str, setup: Setup, built_in: Sequence[str] = ()) -> Any:
    """Return the object that the entry point `name` makes; `key` is the key of the file with the name, for messages.

    Raises:
        ConfigError: there is no such entry point, it cannot be loaded, it refuses its options, or the
            object that it makes lacks a method or cannot be sent to another process.
    """
    where, make = load(GROUPS[kind], name, key, built_in)
    if not callable(make):
        raise ConfigError(f"{where} is not a callable make(setup)")
    try:
        found = result_of(where, make, setup)
    except CtrError as error:
        raise ConfigError(str(error)) from error
    if missing := [method for method in METHODS[kind] if not hasattr(found, method)]:
        raise ConfigError(f"{where} made a {type(found).__name__} without {', '.join(missing)}")
    try:
        pickle.dumps(found)
    except Exception as error:  # foreign objects can raise anything
        raise ConfigError(
            f"{where} made an object that cannot be sent to another process ({error}); define its class or function at"
            " the top of its module"
        ) from error
    return found


def load(group: str, name: str, key: str, built_in: Sequence[str] = ()) -> tuple[str, Callable[..., Any]]:
    """Return a description of an entry point, for messages, and the object that it names.

    Raises:
        ConfigError: none or several have this name, or the import fails.
    """
    points = entry_points(group=group)
    found = list(points.select(name=name))
    if not found:
        known = ", ".join((*built_in, *sorted({point.name for point in points})))
        raise ConfigError(
            f"{key} = '{name}' is not one of {known or 'the installed ones (none)'}; custom code needs an entry"
            f" point of the group {group}"
        )
    if len(found) > 1:
        origins = ", ".join(map(_origin, found))
        raise ConfigError(f"{key} = '{name}' is installed more than once: {origins}; remove all but one")
    where = f"{key} = '{name}' ({_origin(found[0])})"
    try:
        return where, found[0].load()
    except (Exception, SystemExit) as error:  # an import of foreign code can raise anything
        raise ConfigError(f"{where} cannot be loaded: {type(error).__name__}: {error}") from error


def _origin(point: EntryPoint) -> str:
    """Return the module, the attribute and the package of an entry point, for messages."""
    return point.value if point.dist is None else f"{point.value} of {point.dist.name}"
