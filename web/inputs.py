"""Widgets whose values are looked at again on the server: their own bounds bind only honest browsers."""

import math
from typing import Any, NamedTuple

from station.desk import DeskError


class Number(NamedTuple):
    """A number that a person sets, and its bounds, in the unit of its label."""

    handle: Any  #: viser's widget
    name: str
    unit: str
    lower: float
    upper: float

    def read(self) -> float:
        """The value.

        Raises:
            DeskError: not finite or out of bounds.
        """
        value = self.handle.value
        if not (isinstance(value, int | float) and math.isfinite(value) and self.lower <= value <= self.upper):
            raise DeskError(f"{self.name} {value} {self.unit} is outside {self.lower:g} ... {self.upper:g} {self.unit}")
        return float(value)


class Choice(NamedTuple):
    """One of a few words."""

    handle: Any
    name: str
    options: tuple[str, ...]

    def read(self) -> str:
        """The option.

        Raises:
            DeskError: it is not one of them.
        """
        if self.handle.value not in self.options:
            raise DeskError(f"{self.name} '{str(self.handle.value)[:60]}' is not one of: {', '.join(self.options)}")
        return self.handle.value
