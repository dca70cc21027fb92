"""Strict configuration: TOML files are read into frozen models that refuse unknown keys.

An error message names the file, the key, the value and what was expected. Values use SI units.
"""

import json
import os
import re
import tomllib
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, Field, ValidationError

from core.errors import CtrError
from core.strict import Direction as Direction  # the alias marks what other modules import from here
from core.strict import NotNegative as NotNegative
from core.strict import Position as Position
from core.strict import Positive as Positive
from core.strict import Row as Row
from core.strict import Strict as Strict
from core.strict import Vector as Vector
from station.regular_file import is_hidden

#: Longest silence of a device that a file may allow [s]. Without a tracker for 2 s the tip left a circle (10 mm radius,
#: 8 s) by up to 1.7 mm in the labs gentle, realistic and uncalibrated, and by up to 4.2 mm within 5 s.
MAX_SILENCE_S = 2.0
#: Delay of a device; the bound finds a value in milliseconds.
Latency = Annotated[float, Field(ge=0.0, le=1.0)]

_TABLE = re.compile(r"\[(\[?)\s*([^\[\]]+?)\s*\]?\]\s*(?:#.*)?")
_KEY = re.compile(r"\s*((?:[\w-]+|\"[^\"]*\"|'[^']*')(?:\s*\.\s*(?:[\w-]+|\"[^\"]*\"|'[^']*'))*)\s*=(.*)")
_PART = re.compile(r"[\w-]+|\"[^\"]*\"|'[^']*'")
_STRING = re.compile(r"\"(?:\\.|[^\"\\])*\"|'[^']*'")

#: Names of a key and of the tables around it, outermost first.
KeyPath = tuple[str, ...]


def line_of(text: str, *keys: str) -> int | None:
    """Return the line, counted from 1, of the first of `keys` that is set (`devices.stages.port`, `tubes.0.name`).

    If no key is set, return the line of the table that should contain one; None if the table is missing, too.
    (`tomllib` does not provide line numbers.)
    """
    lines = _lines(text)
    paths = [tuple(key.split(".")) for key in keys]
    for short in range(max(map(len, paths), default=0)):
        for path in paths:
            if len(path) > short and path[: len(path) - short] in lines:
                return lines[path[: len(path) - short]]
    return None


def _lines(text: str) -> dict[KeyPath, int]:
    """Return the lines of all keys and tables; items of arrays of tables have numbers."""
    found: dict[KeyPath, int] = {}
    counts: dict[KeyPath, int] = {}
    table: KeyPath = ()
    depth, quoted = 0, ""
    for number, line in enumerate(text.splitlines(), 1):
        if quoted:
            quoted = "" if quoted in line else quoted
            continue
        if depth == 0 and (header := _TABLE.fullmatch(line.strip())):
            table = _numbered(_parts(header[2]), counts)
            if header[1]:
                counts[table] = counts.get(table, -1) + 1
                found.setdefault(table, number)
                table = (*table, str(counts[table]))
            for length in range(1, len(table) + 1):
                found.setdefault(table[:length], number)
            continue
        value = line
        if depth == 0 and (key := _KEY.match(line)):
            found.setdefault((*table, *_parts(key[1])), number)
            value = key[2]
        for mark in ('"""', "'''"):
            if value.count(mark) % 2:
                quoted = mark
        bare = _STRING.sub("", value).split("#")[0]
        depth = max(0, depth + bare.count("[") + bare.count("{") - bare.count("]") - bare.count("}"))
    return found


def _parts(dotted: str) -> KeyPath:
    return tuple(part.strip("\"'") for part in _PART.findall(dotted))


def _numbered(path: KeyPath, counts: dict[KeyPath, int]) -> KeyPath:
    """Return the path with item numbers; a table inside an array of tables belongs to the last item."""
    result: KeyPath = ()
    for part in path[:-1]:
        result = (*result, part)
        if result in counts:
            result = (*result, str(counts[result]))
    return (*result, path[-1])


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


class ConfigError(CtrError):
    """An invalid configuration, refused before anything starts."""


Model = TypeVar("Model", bound=BaseModel)


def has_control_characters(text: str) -> bool:
    """Return whether a text has line breaks or other control characters, which a one-line text must not have."""
    return any(unicodedata.category(letter) in ("Cc", "Zl", "Zp") for letter in text)


def _is_line(text: str) -> str:
    if has_control_characters(text):
        raise ValueError("line breaks and other control characters are not allowed; remove them")
    return text


#: Text for a line of a terminal, a log or a table.
Line = Annotated[str, AfterValidator(_is_line)]


#: Name of a tube, joint or case; it is used in column and file names.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]*$", max_length=60)]


#: Format of robot, station, lab and experiment files. It increases when an older ctr-station would misread a new file.
FORMAT = 1
#: Value of the key `format` of such a file.
Format = Annotated[int, Field(ge=1, le=FORMAT)]

PRESETS = Path(__file__).parent / "presets"

#: Largest number of errors that are reported for one file or request; further errors are only counted.
MAX_REPORTED_ERRORS = 6
#: Environment variable with the folder of custom experiments; child processes inherit it.
EXPERIMENTS_VARIABLE = "CTR_STATION_EXPERIMENTS"


def use_experiments(folder: Path) -> None:
    """Add a folder of custom experiments for this process and its child processes.

    Raises:
        ConfigError: the folder does not exist.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder of experiments")
    os.environ[EXPERIMENTS_VARIABLE] = str(folder.resolve())


def preset_names(kind: str) -> list[str]:
    """Return the names of the presets of a kind (`robots`, `labs`, `experiments`), with custom experiments."""
    return sorted(_presets(kind), key=_natural)


def _natural(name: str) -> list[str | int]:
    """Return a key that sorts names with numbers by these numbers: fig3 before fig10."""
    return [int(part) if number % 2 else part for number, part in enumerate(re.split(r"([0-9]+)", name))]


def is_shipped_preset(kind: str, name: str) -> bool:
    """Return whether a preset belongs to this package, not to a folder of the user.

    Raises:
        ConfigError: there is no preset of this name.
    """
    return _preset(kind, name).is_relative_to(PRESETS)


def _presets(kind: str) -> dict[str, Path]:
    """Return files by name; a custom experiment replaces the station's one with the same name."""
    found = {path.stem: path for path in (PRESETS / kind).glob("*.toml")}
    if kind == "experiments" and (own := os.environ.get(EXPERIMENTS_VARIABLE)):
        mine = (path for path in Path(own).glob("*.toml") if not is_hidden(path))
        found |= {path.stem: path for path in mine if not has_control_characters(path.stem)}
    return found


def preset(kind: str, name: str) -> Path:
    """Return the preset's file; a path to a TOML file is returned unchanged.

    Raises:
        ConfigError: `name` is neither a preset nor a file.
    """
    own = Path(name)
    if own.suffix == ".toml":
        if not own.is_file():
            raise ConfigError(f"{own}: no such file")
        return own
    if not (path := _preset(kind, name)).is_file():  # for example a FIFO, which would block its reader
        raise ConfigError(f"{path}: not a file")
    return path


def _preset(kind: str, name: str) -> Path:
    presets = _presets(kind)
    if name not in presets:
        raise ConfigError(f"'{name}' is not one of the {kind}: {', '.join(preset_names(kind))}; or give a .toml file")
    return presets[name]


class Document(dict[str, Any]):
    """The table of a TOML file, together with the file's text, which gives the line numbers for messages."""

    text: str = ""


def line_reference(table: Mapping[str, Any], message: str, within: str = "") -> str:
    """Return the line of the key in a message, as ` (line 7)`; empty if it is unknown.

    Args:
        table: table of the file, from `read_toml`.
        message: error message that starts with the key, or with `unknown key` and the key.
        within: name of the file's table to search first.
    """
    text = table.text if isinstance(table, Document) else ""
    key = _LEADING_KEY.match(message)
    if key is None or not text:
        return ""
    line = line_of(text, *([f"{within}.{key[1]}"] if within else []), key[1])
    return "" if line is None else f" (line {line})"


_LEADING_KEY = re.compile(r"(?:unknown key )?'?([\w.-]*\w)")


def read_toml(path: Path) -> Document:
    """Return the file's table.

    Raises:
        ConfigError: the file is unreadable or not TOML; the message names the line.
    """
    return parse_toml(read_text(path), str(path))


def read_text(path: Path, refused: type[CtrError] = ConfigError) -> str:
    """Return the file's text, as `text_of` does.

    Raises:
        refused: the file is unreadable or in another encoding; the argument is the class of this exception.
    """
    try:
        return text_of(path.read_bytes())
    except OSError as error:
        raise refused(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        line, wrong = error.object[: error.start].count(b"\n") + 1, error.object[error.start]
        raise refused(f"{path}: not UTF-8 text: byte {wrong:#04x} (line {line}); save it as UTF-8") from None


def text_of(content: bytes) -> str:
    """Return the text of a file in UTF-8, UTF-16 or UTF-32, without a byte order mark and carriage returns.

    Raises:
        UnicodeDecodeError: the file has another encoding.
    """
    return StringIO(content.decode(json.detect_encoding(content)), newline=None).getvalue()


def parse_toml(text: str, source: str) -> Document:
    """Return the table of a TOML text from `source`.

    Raises:
        ConfigError: the text is not TOML (the message names the line), or has a later format.
    """
    try:
        document = Document(tomllib.loads(text))
    # tomllib raises ValueError for a number of 5000 digits and RecursionError for deeply nested brackets.
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{source}: not valid TOML: {error}") from None
    document.text = text
    # Check the format before the keys: a later format may have keys that are unknown here.
    if isinstance(version := document.get("format"), int) and version > FORMAT:
        raise ConfigError(
            f"{source}: format = {version} is later than {FORMAT}, the latest that this ctr-station reads"
            f"{line_reference(document, 'format')}; update ctr-station (CHANGELOG.md lists the changes)"
        )
    return document


def check(
    model: type[Model],
    table: Mapping[str, Any],
    source: str,
    document: Mapping[str, Any] | None = None,
    within: str = "",
) -> Model:
    """Return `table` as a `model`.

    Args:
        model: class of the result.
        table: table to check.
        source: file or other origin, for messages.
        document: table of the whole file, for line numbers, if `table` is only a part of it.
        within: name of the file's table to search first for line numbers.

    Raises:
        ConfigError: invalid keys; the message names them, their values and what was expected.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        messages = error_lines(error.errors(include_url=False), lambda loc: key_of(loc, table))
    except CtrError as error:
        messages = (str(error),)
    lines = table if document is None else document
    raise ConfigError(f"{source}: {'; '.join(text + line_reference(lines, text, within) for text in messages)}")


def error_lines(
    errors: Sequence[Any], key: Callable[[tuple[int | str, ...]], str], what: str = "key"
) -> tuple[str, ...]:
    """Return one line for each error; the last line counts errors beyond `MAX_REPORTED_ERRORS`.

    Args:
        errors: errors that pydantic reports.
        key: function that returns the name of an error's location.
        what: noun for an unknown key, such as `field`.
    """
    # pydantic also reports an error for each table that contains an error, so leave out the errors of whole tables.
    wholes = {one["loc"][:length] for one in errors for length in range(len(one["loc"]))}
    own = [one for one in errors if one["loc"] not in wholes]
    # A misspelt key is also reported as missing: put the key that the file has first.
    ordered = sorted(own, key=lambda one: one["type"] != "extra_forbidden")
    lines = tuple(_error_line(one, key(one["loc"]), what) for one in ordered[:MAX_REPORTED_ERRORS])
    more = len(own) - len(lines)
    return (*lines, f"and {more} more") if more else lines


def _error_line(one: Any, key: str, what: str) -> str:
    if one["type"] == "extra_forbidden":
        return f"unknown {what} '{key}'"
    if one["type"] == "missing":
        return f"'{key}' is missing"
    text = str(one.get("ctx", {}).get("error", one["msg"]))
    shown = repr(one["input"])
    return f"{key} = {shown if len(shown) < 80 else shown[:77] + '...'}: {text}"


def key_of(loc: tuple[int | str, ...], table: Any) -> str:
    """Return the key as it is written in the file, without the `kind` that pydantic adds."""
    parts: list[str] = []
    for number, part in enumerate(loc):
        if isinstance(table, Mapping) and part in table:
            table = table[part]
        elif isinstance(table, list | tuple) and isinstance(part, int):
            table = table[part] if part < len(table) else None
        elif number + 1 < len(loc):
            continue
        parts.append(str(part))
    return ".".join(parts)


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` updated with `over`, table by table; a table with another `kind` replaces the old one."""
    result = dict(base)
    for key, value in over.items():
        old = result.get(key)
        if (
            isinstance(old, Mapping)
            and isinstance(value, Mapping)
            and value.get("kind", old.get("kind")) == old.get("kind")
        ):
            result[key] = merged(old, value)
        else:
            result[key] = value
    return result
