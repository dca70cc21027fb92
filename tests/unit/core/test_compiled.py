"""Compiled code detects NaN; one process compiles it, and again when anything that it depends on has changed."""

import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from core.compiled import compiled
from tests.harness.root import ROOT

LAYOUT = """
from typing import NamedTuple
import numpy as np
from core.compiled import compiled

STEP = 10

class Parts(NamedTuple):
    first: np.ndarray

@compiled
def parts(numbers: np.ndarray) -> Parts:
    return Parts(numbers[{place}:])
"""
USER = """
import numpy as np
from core.compiled import compiled
from layout import STEP, Parts, parts

@compiled
def first(numbers: np.ndarray) -> float:
    return parts(numbers).first[0] + STEP

if __name__ == "__main__":
    print(first(np.arange(4.0)), sum(first.stats.cache_hits.values()))
"""


@compiled
def _finite(value: float) -> bool:
    return math.isfinite(value)


@pytest.mark.parametrize(("value", "finite"), [(1.0, True), (math.nan, False), (math.inf, False), (-math.inf, False)])
def test_compiled_code_detects_nan_and_infinity(value, finite):
    assert _finite(value) == finite


def answer(folder: Path) -> list[str]:
    """Return the function's result in a separate process, and the number of cache hits."""
    # Python detects an outdated .pyc by the time (1 s) and size of its source: two quick edits may look identical.
    environment = {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        [sys.executable, str(folder / "user.py")], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    ).stdout.split()


def test_a_compiled_function_is_recompiled_after_a_change_in_another_file(tmp_path: Path) -> None:
    layout = tmp_path / "layout.py"
    layout.write_text(LAYOUT.format(place=1))
    (tmp_path / "user.py").write_text(USER)

    assert answer(tmp_path) == ["11.0", "0"]
    assert answer(tmp_path) == ["11.0", "1"]
    layout.write_text(LAYOUT.format(place=2).replace("Parts", "Views"))
    (tmp_path / "user.py").write_text(USER.replace("Parts, ", ""))
    assert answer(tmp_path) == ["12.0", "0"]


MANY = 200  #: statements of a function that takes half a second to compile


def test_a_function_that_two_processes_need_at_once_is_compiled_by_one_of_them(tmp_path: Path) -> None:
    lines = "\n".join(f"    total = total * {number}.0 + np.sin(total)" for number in range(MANY))
    (tmp_path / "user.py").write_text(f"""
import sys
import numpy as np
from core.compiled import compiled

@compiled
def slow(total: float) -> float:
{lines}
    return total

print("imported", flush=True)
sys.stdin.read()
print(slow(0.0), sum(slow.stats.cache_hits.values()))
""")
    command, environment = [sys.executable, str(tmp_path / "user.py")], {"PYTHONPATH": str(ROOT)}
    reader, writer = os.pipe()
    both = [
        subprocess.Popen(command, cwd=ROOT, env=environment, text=True, stdin=reader, stdout=subprocess.PIPE)
        for _ in range(2)
    ]
    os.close(reader)
    for one in both:
        assert one.stdout is not None
        assert one.stdout.readline() == "imported\n"
    os.close(writer)  # both processes now call the function
    (first, loaded), (second, also) = (one.communicate()[0].split() for one in both)
    assert first == second
    assert sorted((loaded, also)) == ["0", "1"]
