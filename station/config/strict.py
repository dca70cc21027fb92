"""Strict configuration: TOML files read into frozen models that refuse what they do not know.

A message names the file, the key, the value and what was expected. Values are SI.
"""

import math
import os
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from core.errors import CtrError
from station.config.toml_lines import line_of


class ConfigError(CtrError):
    """A configuration that cannot be, refused before anything starts."""


class Strict(BaseModel):
    """Base of every configuration model: frozen, no unknown key, no NaN, no infinity, no text for a number."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
# Files and requests have arrays where the models have tuples: strict goes for what is inside.
Row = Field(strict=False)
Vector = Annotated[tuple[float, float, float], Row]
Model = TypeVar("Model", bound=BaseModel)


def _has_length(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    if not 1e-9 <= math.hypot(*direction) <= 1e9:
        raise ValueError("a direction needs a length, 1e-9 ... 1e9")
    return direction


#: World frame; its length does not matter.
Direction = Annotated[Vector, AfterValidator(_has_length)]
#: Of tubes, joints and cases, as they stand in column and file names.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_-]*$", max_length=60)]

#: Of robot, station, lab and experiment files; one more when an older ctr-station would misunderstand a new file.
FORMAT = 1
#: What such a file says of itself.
Format = Annotated[int, Field(ge=1, le=FORMAT)]

PRESETS = Path(__file__).parent / "presets"

#: So many complaints about one file or request are told.
MOST_TOLD = 6
#: Environment variable that names the folder of one's own experiments, for child processes too.
OWN_EXPERIMENTS = "CTR_STATION_EXPERIMENTS"


def use_experiments(folder: Path) -> None:
    """From now on find experiments in this folder too, in this process and those that it starts.

    Raises:
        ConfigError: there is no such folder.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder of experiments")
    os.environ[OWN_EXPERIMENTS] = str(folder.resolve())


def preset_names(kind: str) -> list[str]:
    """Names of the presets of a kind (`robots`, `labs`, `experiments`), one's own experiments among them."""
    return sorted(_presets(kind))


def _presets(kind: str) -> dict[str, Path]:
    """Files by name; one's own go before those that come with the station."""
    found = {path.stem: path for path in (PRESETS / kind).glob("*.toml")}
    if kind == "experiments" and (own := os.environ.get(OWN_EXPERIMENTS)):
        found |= {path.stem: path for path in Path(own).glob("*.toml")}
    return found


def preset(kind: str, name: str) -> Path:
    """The preset's file; a path to a file of one's own is taken as it is.

    Raises:
        ConfigError: neither a preset nor a file.
    """
    own = Path(name)
    if own.suffix == ".toml":
        if not own.is_file():
            raise ConfigError(f"{own}: no such file")
        return own
    presets = _presets(kind)
    if name not in presets:
        raise ConfigError(f"'{name}' is not one of the {kind}: {', '.join(sorted(presets))}; or give a .toml file")
    return presets[name]


class Document(dict[str, Any]):
    """A file's table, and its text for the line that a message is about."""

    text: str = ""


def on_line(table: Mapping[str, Any], message: str, within: str = "") -> str:
    """Where in a file what a message complains about stands: ` (line 7)`; empty when that is not known.

    Args:
        table: of the file, as `read_toml` gives it.
        message: begins with the key, or with `unknown key` and the key.
        within: a table of the file to look in first.
    """
    text = table.text if isinstance(table, Document) else ""
    key = _LEADING_KEY.match(message)
    if key is None or not text:
        return ""
    line = line_of(text, *([f"{within}.{key[1]}"] if within else []), key[1])
    return "" if line is None else f" (line {line})"


_LEADING_KEY = re.compile(r"(?:unknown key )?'?([\w.-]*\w)")


def read_toml(path: Path) -> Document:
    """The file's table.

    Raises:
        ConfigError: unreadable, or not TOML; with the line.
    """
    return parse_toml(read_text(path), str(path))


def read_text(path: Path, refused: type[CtrError] = ConfigError) -> str:
    """The file's text, without the mark that some programs put before it.

    Raises:
        refused: unreadable, or not UTF-8.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise refused(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        line, wrong = error.object[: error.start].count(b"\n") + 1, error.object[error.start]
        raise refused(f"{path}: not UTF-8 text: byte {wrong:#04x} (line {line}); save it as UTF-8") from None


def parse_toml(text: str, source: str) -> Document:
    """The table of a text that comes from `source`.

    Raises:
        ConfigError: not TOML, with the line; or of a later format.
    """
    try:
        document = Document(tomllib.loads(text))
    # A number of 5000 digits is a plain ValueError, a deep nest of brackets a RecursionError.
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{source}: not valid TOML: {error}") from None
    document.text = text
    # Before any of its keys is looked at: one that is unknown here may be good there.
    if isinstance(told := document.get("format"), int) and told > FORMAT:
        raise ConfigError(
            f"{source}: format = {told} is later than {FORMAT}, the latest that this ctr-station reads"
            f"{on_line(document, 'format')}; update ctr-station (CHANGELOG.md says what has changed)"
        )
    return document


def check(
    model: type[Model],
    table: Mapping[str, Any],
    source: str,
    document: Mapping[str, Any] | None = None,
    within: str = "",
) -> Model:
    """`table` as a `model`; it comes from a file that is `document`, as `on_line` takes it, if it is not one itself.

    Raises:
        ConfigError: the first wrong key, its value and what was expected; `source` is the file.
    """
    try:
        return model.model_validate(table)
    except ValidationError as error:
        told = complaints(error.errors(include_url=False), lambda loc: key_of(loc, table))
    except CtrError as error:
        told = (str(error),)
    lines = table if document is None else document
    raise ConfigError(f"{source}: {'; '.join(text + on_line(lines, text, within) for text in told)}")


def explain(error: ValidationError, table: Mapping[str, Any]) -> str:
    """What pydantic complains of about `table` in one line: keys, values, what was expected."""
    return "; ".join(complaints(error.errors(include_url=False), lambda loc: key_of(loc, table)))


def complaints(
    errors: Sequence[Any], key: Callable[[tuple[int | str, ...]], str], what: str = "key"
) -> tuple[str, ...]:
    """Complaints, one line each; of a long list the rest is counted.

    Args:
        errors: as pydantic has them.
        key: the words for where one of them is.
        what: it is that is unknown.
    """
    # What is wrong inside something makes pydantic complain of the whole, too.
    wholes = {one["loc"][:length] for one in errors for length in range(len(one["loc"]))}
    own = [one for one in errors if one["loc"] not in wholes]
    # A misspelt key is also a missing one: name what the file has first.
    ordered = sorted(own, key=lambda one: one["type"] != "extra_forbidden")
    told = tuple(_complaint(one, key(one["loc"]), what) for one in ordered[:MOST_TOLD])
    more = len(own) - len(told)
    return (*told, f"and {more} more") if more else told


def _complaint(one: Any, key: str, what: str) -> str:
    if one["type"] == "extra_forbidden":
        return f"unknown {what} '{key}'"
    if one["type"] == "missing":
        return f"'{key}' is missing"
    text = str(one.get("ctx", {}).get("error", one["msg"]))
    shown = repr(one["input"])
    return f"{key} = {shown if len(shown) < 80 else shown[:77] + '...'}: {text}"


def key_of(loc: tuple[int | str, ...], table: Any) -> str:
    """The key as the file has it: pydantic adds the `kind` that it chose."""
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
    """`base` with `over` laid on top, table by table; a table with another `kind` replaces the old one."""
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
