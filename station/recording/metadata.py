"""Conversion of a recording's metadata to texts by name, because MCAP metadata are texts.

A value that is a text is stored unchanged, so that any MCAP tool shows it. Any other value is stored as JSON.
"""

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from platform import platform, python_version
from typing import Any

from station.control.telemetry import Channel

#: Names of the metadata records at the start of a recording.
RUN_RECORD = "run"
CHANNELS_RECORD = "channels"
#: Format number of new recordings. It is raised when an older ctr-station would misunderstand new recordings.
FORMAT = 2
#: Names of channel groups in recordings of format 1, with their names since format 2.
FORMAT_1_GROUPS = {
    "held": "estimates_frozen",
    "asked_kind": "request_kind",
    "asked_time": "request_time",
    "asked": "request",
    "asked_velocity": "request_velocity",
}
#: Packages whose versions may change a result, including this program.
PACKAGES = ("ctr-station", "numpy", "numba", "scipy", "filterpy")


def texts(values: Mapping[str, Any]) -> dict[str, str]:
    """Return metadata values as texts by name; `values_of` is the inverse function."""
    return {name: _text(value) for name, value in values.items()}


def values_of(written: Mapping[str, str]) -> dict[str, Any]:
    """Return the metadata values from the texts that `texts` has created."""
    return {name: _value(text) for name, text in written.items()}


def channel_texts(channels: Sequence[Channel]) -> dict[str, str]:
    """Return names and units of the channels as texts, in the order of the columns."""
    return {"columns": json.dumps([list(channel) for channel in channels], ensure_ascii=False)}


def channels_of(written: Mapping[str, str], file_format: int = FORMAT) -> tuple[Channel, ...]:
    """Return the channels from the texts of `channel_texts`; channels of format 1 get their present names."""
    groups = FORMAT_1_GROUPS if file_format < 2 else {}
    return tuple(Channel(_renamed(str(name), groups), str(unit)) for name, unit in json.loads(written["columns"]))


def _renamed(name: str, groups: Mapping[str, str]) -> str:
    """Return a channel's name; if its group is in `groups`, the group is replaced by the new name."""
    group, dot, member = name.partition(".")
    return f"{groups.get(group, group)}{dot}{member}"


def format_of(run: Mapping[str, Any]) -> Any:
    """Return the format number of a recording with this metadata; without one, as in version 0.1.0, it is 1."""
    return run.get("format", 1)


def versions() -> dict[str, str]:
    """Return the versions of the packages on which a result depends, of Python and of the system."""
    return {name: version(name) for name in PACKAGES} | {"python": python_version(), "system": platform()}


def is_later(run: Mapping[str, Any]) -> str:
    """Return why this version of ctr-station cannot read a recording with this metadata; empty if it can."""
    recorded = format_of(run)
    if isinstance(recorded, int) and recorded <= FORMAT:
        return ""
    made = run.get("versions")
    by = made.get("ctr-station", "of a later version") if isinstance(made, Mapping) else "of a later version"
    return (
        f"format = {recorded} is later than {FORMAT}, the latest that this ctr-station reads; it was recorded by"
        f" ctr-station {by}: update this one, or export the run there"
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
