"""Measure this project: `python -m tests.measure NAME`, or `report [FILE]` for all measurements in one file.

`ctr-station bench` measures what a user of this computer needs; these measurements judge the project's own code.
"""

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tests.measure.accuracy import accuracy
from tests.measure.report import MEASURES, describe_machine, measure_all, measured_toml
from tests.measure.solver import solver

#: Measurements by name, those of the report and the ones that take minutes.
NAMES: Mapping[str, Callable[[], dict[str, Any]]] = {
    **{name: measure for name, (_, measure) in MEASURES.items()},
    "accuracy": accuracy,
    "solver": solver,
}


def main(name: str, *files: str) -> None:
    """Print one measurement as JSON, or write the report of all to a file."""
    if name == "report":
        machine = describe_machine()  # before the measurements: they raise the computer's load
        found = dict(measure_all(lambda each: print(each, file=sys.stderr)))  # noqa: T201
        Path(*files or ("measured.toml",)).write_text(measured_toml(machine, found), encoding="utf-8")
        return
    print(json.dumps(NAMES[name](), indent=2))  # noqa: T201


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in (*NAMES, "report"):
        sys.exit(f"usage: python -m tests.measure NAME [FILE], NAME one of: {', '.join(NAMES)}, report")
    main(*sys.argv[1:])
