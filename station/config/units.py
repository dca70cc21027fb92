"""Numbers as a person reads them: millimetres and degrees, no more digits than matter. Files and requests are SI."""

import math
import re

#: What stands for an SI unit where a person reads, and by how much more of it there is; the page's own table agrees.
SHOWN = {
    "m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "m/s^2": ("mm/s²", 1e3),
    "rad": ("°", 180.0 / math.pi), "rad/s": ("°/s", 180.0 / math.pi),
}  # fmt: skip
DIGITS = 4


def shown(value: float, unit: str = "") -> str:
    """A number with its unit: `shown(0.01, "m")` is `10 mm`."""
    name, scale = SHOWN.get(unit, (unit, 1.0))
    number = f"{value * scale:.{DIGITS}g}"
    return f"{number} {name}".strip()


def unit_in(description: str | None, *, turns: bool = True) -> str:
    """The unit that a key's description names in brackets; of `[rad or m]` the first for what turns."""
    found = re.search(r"\[([^\]]+)\]", description or "")
    if found is None:
        return ""
    choices = found[1].split(" or ")
    return choices[0] if turns else choices[-1]
