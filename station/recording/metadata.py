"""Conversion of a recording's metadata to texts by name, because MCAP metadata are texts.

A value that is a text is stored unchanged, so that any MCAP tool shows it. Any other value is stored as JSON.
"""

import json
from collections.abc import Mapping
from importlib.metadata import version
from platform import platform, python_version
from typing import Any

from station.control.telemetry import Channel
from station.recording.data_section import RowFormat

#: Names of the metadata records at the start of a recording.
RUN_RECORD = "run"
CHANNELS_RECORD = "channels"
#: Format number of new recordings. It increases when an older ctr-station would misunderstand new recordings.
FORMAT = 1
#: Packages whose versions may change a result, including this program.
PACKAGES = ("ctr-station", "numpy", "numba", "scipy", "filterpy")


def texts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return metadata values as texts by name; `values_of` is the inverse function."""
    return {name: _text(value) for name, value in values.items()}


def values_of(written: Mapping[str, str]) -> dict[str, Any]:
    """Return the metadata values from the texts that `texts` has created."""
    return {name: _value(text) for name, text in written.items()}


def channel_texts(rows: RowFormat) -> dict[str, str]:
    """Return name, unit and type of each channel as texts, in the order of the columns."""
    columns = [[*channel, kind] for channel, kind in zip(rows.channels, rows.types, strict=True)]
    return {"columns": json.dumps(columns, ensure_ascii=False)}


def row_format(written: Mapping[str, str]) -> RowFormat:
    """Return the format of the rows from the texts of `channel_texts`."""
    columns: list[list[str]] = json.loads(written["columns"])
    return RowFormat([Channel(name, unit) for name, unit, _ in columns], [kind for _, _, kind in columns])


def versions() -> dict[str, str]:
    """Return the versions of the packages on which a result depends, of Python and of the system."""
    return {name: version(name) for name in PACKAGES} | {"python": python_version(), "system": platform()}


def is_later(run: Mapping[str, Any]) -> str:
    """Return why this version cannot read a recording with this metadata; empty if it can, or without metadata."""
    recorded = run.get("format", FORMAT)
    if isinstance(recorded, int) and recorded <= FORMAT:
        return ""
    made = run.get("versions")
    by = made.get("ctr-station", "of a later version") if isinstance(made, Mapping) else "of a later version"
    return (
        f"format = {recorded} is later than {FORMAT}, the latest that this ctr-station reads; it was recorded by"
        f" ctr-station {by}: update this ctr-station, or export the run with that version"
    )


def _text(value: Any) -> str:
    if isinstance(value, str) and _value(value) == value:
        return value
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
