"""Settings of a device that affect its motions or positions: what each means, and what the driver did with it."""

from dataclasses import dataclass

Value = float | str


@dataclass(frozen=True)
class Setting:
    """One setting. Each driver has a table of its settings, and records their values while it connects."""

    name: str  #: as the device's manual names it, such as `$1`, `0x60A9`, `M211`, `accel`
    meaning: str  #: what the setting determines; braces `{}` in the text are replaced by the value
    refused: str = ""  #: advice in the error if the driver refuses the value; empty: no value is refused

    def text(self, found: Value | None, wanted: Value | None = None) -> str:
        """Return a text with the value found, its meaning and the value set; `found` None: it was not read before."""
        value = shown(wanted if found is None else found)
        text = f"{value}: {self.meaning.format(value)}"
        if found is None:
            return f"{text}; written at each connection"
        return text if wanted is None or shown(wanted) == value else f"{text}; set to {shown(wanted)}"


def shown(value: Value | None) -> str:
    """Return a value as text, numbers with at most three decimals."""
    if value is None or isinstance(value, str):
        return value or "none"
    return f"{value:.3f}".rstrip("0").rstrip(".")
