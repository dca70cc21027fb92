"""Process that runs golden cases: `python -m tests.golden.child OUT [CASE ...]`."""

import json
import sys
from pathlib import Path

from core.compiled import _SOURCES
from tests.golden.cases import CASES
from tests.golden.record import record


def main() -> None:
    out, *names = sys.argv[1:]
    records = {name: record(CASES[name]()) for name in names or CASES}
    compiled = [function.py_func.__qualname__ for function in _SOURCES if sum(function.stats.cache_misses.values())]
    Path(out).write_text(json.dumps({"compiled": compiled, "records": records}), encoding="utf-8")


if __name__ == "__main__":
    main()
