"""Formatting of numbers for people: millimetres and degrees with few digits. Files and requests use SI units."""

import math
import re

#: Display unit of each SI unit, and the factor from the SI unit to it; the page has the same table.
DISPLAY_UNITS = {
    "m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "m/s^2": ("mm/s²", 1e3),
    "rad": ("°", 180.0 / math.pi), "rad/s": ("°/s", 180.0 / math.pi),
}  # fmt: skip
SIGNIFICANT_DIGITS = 4


def format_quantity(value: float, unit: str = "") -> str:
    """Return a number with its unit: `format_quantity(0.01, "m")` is `10 mm`."""
    name, scale = DISPLAY_UNITS.get(unit, (unit, 1.0))
    number = f"{value * scale:.{SIGNIFICANT_DIGITS}g}"
    return f"{number} {name}".strip()


def unit_of_description(description: str | None, *, turns: bool = True) -> str:
    """Return the unit in the brackets of a key's description.

    A description such as `[rad or m]` has two units: the first is for rotations, the second for translations.
    """
    found = re.search(r"\[([^\]]+)\]", description or "")
    if found is None:
        return ""
    choices = found[1].split(" or ")
    return choices[0] if turns else choices[-1]
