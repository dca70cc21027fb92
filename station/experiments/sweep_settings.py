"""Settings of a sweep: `--set key=a,b,c` options, converted to tables of an experiment's file."""

import itertools
import re
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any

from station.config.strict import ConfigError

#: Value that is read as a text although it has no quotes, such as `dual_layer`.
BARE_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")

#: One combination of values: pairs of a dotted key of an experiment's file and its value, in the order of the options.
Setting = tuple[tuple[str, Any], ...]


def settings(options: Sequence[str]) -> list[Setting]:
    """Return every combination of the values in `key=a,b,c` options; values are TOML, but words need no quotes.

    Raises:
        ConfigError: an option has no key or no value, or two options have the same key.
    """
    choices: list[list[tuple[str, Any]]] = []
    for option in options:
        key, equals, text = option.partition("=")
        key = key.strip()
        if not key or not equals or not text.strip():
            raise ConfigError(f"--set {option}: write KEY=VALUE or KEY=A,B,C, for example controller.k1=1,2.5,5")
        if key in [listed[0][0] for listed in choices]:
            raise ConfigError(f"--set {option}: '{key}' is set twice; give all its values in one option")
        choices.append([(key, _value(part, option)) for part in _parts(text)])
    return list(itertools.product(*choices))


def nested(setting: Setting) -> dict[str, Any]:
    """Return a setting as nested tables of an experiment's file: `controller.k1` becomes `{"controller": {"k1": ...}}`.

    Raises:
        ConfigError: a key is set to a value and is also the parent of another key.
    """
    table: dict[str, Any] = {}
    for key, value in setting:
        at = table
        *parents, last = key.split(".")
        for part in parents:
            at = at.setdefault(part, {})
            if not isinstance(at, dict):
                raise ConfigError(f"--set {key}: '{part}' is set to a value, so it has no keys")
        if last in at:
            raise ConfigError(f"--set {key}: keys below '{key}' are set too; set the table or its keys")
        at[last] = value
    return table


def _parts(text: str) -> Iterator[str]:
    """Split a text at its commas outside brackets and quotes."""
    depth, quote, first = 0, "", 0
    for at, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character in "[{":
            depth += 1
        elif character in "]}":
            depth -= 1
        elif character == "," and depth == 0:
            yield text[first:at].strip()
            first = at + 1
    yield text[first:].strip()


def _value(text: str, option: str) -> Any:
    if not text:
        raise ConfigError(f"--set {option}: a value is missing between the commas")
    if BARE_WORD.fullmatch(text) and text not in ("true", "false", "inf", "nan"):
        return text
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(
            f"--set {option}: '{text}' is not a TOML value: {error}; put a text with special characters in quotes"
        ) from None
