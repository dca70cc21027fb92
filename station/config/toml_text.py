"""Tables as TOML text; Python's standard library can only read TOML."""

import json
from collections.abc import Mapping, Sequence
from typing import Any


def toml_string(value: str) -> str:
    """Return a TOML string on one line, escaped as in JSON; TOML forbids one more control character, DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_lines(table: Mapping[str, Any]) -> list[str]:
    """Return a line for each key; values are texts, numbers, Booleans, lists or tables. Keys with None are left out."""
    return [f"{key} = {_value(value)}" for key, value in table.items() if value is not None]


def _value(value: Any) -> str:
    match value:
        case bool():
            return str(value).lower()
        case int() | float():
            return repr(value)
        case str():
            return toml_string(value)
        case Mapping():
            return f"{{ {', '.join(toml_lines(value))} }}"
        case Sequence() if value and isinstance(value[0], Sequence) and not isinstance(value[0], str):
            rows = "".join(f"  {_value(row)},\n" for row in value)
            return f"[\n{rows}]"
        case Sequence():
            return f"[{', '.join(map(_value, value))}]"
        case _:
            raise TypeError(f"{value!r} cannot be written to a TOML file")
