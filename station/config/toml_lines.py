"""Line numbers of the keys of a TOML file, for messages; `tomllib` does not provide them."""

import re

_TABLE = re.compile(r"\[(\[?)\s*([^\[\]]+?)\s*\]?\]\s*(?:#.*)?")
_KEY = re.compile(r"\s*((?:[\w-]+|\"[^\"]*\"|'[^']*')(?:\s*\.\s*(?:[\w-]+|\"[^\"]*\"|'[^']*'))*)\s*=(.*)")
_PART = re.compile(r"[\w-]+|\"[^\"]*\"|'[^']*'")
_STRING = re.compile(r"\"(?:\\.|[^\"\\])*\"|'[^']*'")

Path = tuple[str, ...]


def line_of(text: str, *keys: str) -> int | None:
    """Return the line, counted from 1, of the first of `keys` that is set (`devices.stages.port`, `tubes.0.name`).

    If no key is set, return the line of the table that should contain one; None if the table is missing, too.
    """
    lines = _lines(text)
    paths = [tuple(key.split(".")) for key in keys]
    for short in range(max(map(len, paths), default=0)):
        for path in paths:
            if len(path) > short and path[: len(path) - short] in lines:
                return lines[path[: len(path) - short]]
    return None


def _lines(text: str) -> dict[Path, int]:
    """Return the lines of all keys and tables; items of arrays of tables have numbers."""
    found: dict[Path, int] = {}
    counts: dict[Path, int] = {}
    table: Path = ()
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


def _parts(dotted: str) -> Path:
    return tuple(part.strip("\"'") for part in _PART.findall(dotted))


def _numbered(path: Path, counts: dict[Path, int]) -> Path:
    """Return the path with item numbers; a table inside an array of tables belongs to the last item."""
    result: Path = ()
    for part in path[:-1]:
        result = (*result, part)
        if result in counts:
            result = (*result, str(counts[result]))
    return (*result, path[-1])
