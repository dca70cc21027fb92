"""What a sweep sets: `key=a,b,c` options as tables of an experiment's file."""

import itertools
import re
import tomllib
from collections.abc import Iterator, Sequence
from typing import Any

from station.config.strict import ConfigError

#: What stands for itself as a text.
WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*")

#: Dotted keys of an experiment's file and the values they get, in the order they were given.
Setting = tuple[tuple[str, Any], ...]


def settings(options: Sequence[str]) -> list[Setting]:
    """Every combination of the values in `key=a,b,c` options; values are TOML, plain words are texts.

    Raises:
        ConfigError: no key, no value, or a key twice.
    """
    choices: list[list[tuple[str, Any]]] = []
    for option in options:
        key, equals, text = option.partition("=")
        key = key.strip()
        if not key or not equals or not text.strip():
            raise ConfigError(f"--set {option}: write KEY=VALUE or KEY=A,B,C, for example controller.k1=1,2.5,5")
        if key in [listed[0][0] for listed in choices]:
            raise ConfigError(f"--set {option}: '{key}' was set before; give all its values at once")
        choices.append([(key, _value(part, option)) for part in _parts(text)])
    return list(itertools.product(*choices))


def nested(setting: Setting) -> dict[str, Any]:
    """The setting as a table of an experiment's file.

    Raises:
        ConfigError: one key goes through another's value.
    """
    table: dict[str, Any] = {}
    for key, value in setting:
        at = table
        *way, last = key.split(".")
        for part in way:
            at = at.setdefault(part, {})
            if not isinstance(at, dict):
                raise ConfigError(f"--set {key}: '{part}' has a value of its own")
        if last in at:
            raise ConfigError(f"--set {key}: parts of it are set too")
        at[last] = value
    return table


def _parts(text: str) -> Iterator[str]:
    """Split at commas outside brackets and quotes."""
    depth, quote, begin = 0, "", 0
    for at, sign in enumerate(text):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "\"'":
            quote = sign
        elif sign in "[{":
            depth += 1
        elif sign in "]}":
            depth -= 1
        elif sign == "," and depth == 0:
            yield text[begin:at].strip()
            begin = at + 1
    yield text[begin:].strip()


def _value(text: str, option: str) -> Any:
    if not text:
        raise ConfigError(f"--set {option}: a value is missing between the commas")
    if WORD.fullmatch(text) and text not in ("true", "false", "inf", "nan"):
        return text
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"--set {option}: '{text}' is no value: {error}; texts with signs go in quotes") from None
