"""What a recording says about itself, as MCAP keeps it: texts by name.

A text stays as it is, so that any MCAP tool shows it; everything else is JSON.
"""

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from platform import platform, python_version
from typing import Any

from station.control.telemetry import Channel

#: Metadata records at the head of a recording.
RUN = "run"
CHANNELS = "channels"
#: Of the recordings that are written; one more when an older ctr-station would misunderstand them.
FORMAT = 1
#: What a result depends on, besides this program.
PACKAGES = ("ctr-station", "numpy", "numba", "scipy", "filterpy")


def texts(values: Mapping[str, Any]) -> dict[str, str]:
    """Values as texts, so that `values_of` gives them back."""
    return {name: _text(value) for name, value in values.items()}


def values_of(written: Mapping[str, str]) -> dict[str, Any]:
    """Inverse of `texts`."""
    return {name: _value(text) for name, text in written.items()}


def channel_texts(channels: Sequence[Channel]) -> dict[str, str]:
    """Names and units in the order of the columns."""
    return {"columns": json.dumps([list(channel) for channel in channels], ensure_ascii=False)}


def channels_of(written: Mapping[str, str]) -> tuple[Channel, ...]:
    """Inverse of `channel_texts`."""
    return tuple(Channel(str(name), str(unit)) for name, unit in json.loads(written["columns"]))


def versions() -> dict[str, str]:
    """Of the packages that a result depends on, of Python and the system."""
    return {name: version(name) for name in PACKAGES} | {"python": python_version(), "system": platform()}


def is_later(run: Mapping[str, Any]) -> str:
    """Why a recording with this metadata cannot be read here; empty when it can.

    Those of version 0.1.0 do not tell their format, which is the first.
    """
    told = run.get("format", 1)
    if isinstance(told, int) and told <= FORMAT:
        return ""
    made = run.get("versions")
    by = made.get("ctr-station", "of a later version") if isinstance(made, Mapping) else "of a later version"
    return (
        f"format = {told} is later than {FORMAT}, the latest that this ctr-station reads; it was recorded by"
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
