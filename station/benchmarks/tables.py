"""Results of benchmarks as tables."""

from collections.abc import Iterator, Mapping
from typing import Any, cast

from rich.table import Table


def table(title: str, result: Mapping[str, Any]) -> Table:
    """Return the result of a benchmark as a table for the terminal."""
    shown = Table(title=f"bench {title}", title_style="")
    shown.add_column("figure")
    shown.add_column("value", justify="right")
    for figure, value in flat(result):
        shown.add_row(figure, f"{value}")
    return shown


def flat(result: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield names and values of a nested result; the name of an inner value starts with the outer keys."""
    for key, value in result.items():
        if isinstance(value, Mapping):
            yield from flat(cast(Mapping[str, Any], value), f"{before}{key} ")
        else:
            yield f"{before}{key}", value
