"""Insert small defects into the product, and count which of them the tests find.

`python -m tests.tools.mutations [--count 60] [--seed 1] [--only 3,17] [--whole]`

Each defect is one changed place of one file: a sign, a bound, a unit, a dropped check, or a swapped axis. The rooms of
the product take turns. The program works in a copy of the project without its Git folder and prints one line for each
defect: the test that fails first, or that none fails. It runs the tests that import the changed file, then those of
the same room, then the golden rows; with `--whole` also the whole default set.
"""

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.harness.root import ROOT

#: Folders whose files are examples or programs to run by hand.
SKIPPED = ("station/docs/", "station/benchmarks/")
TIMEOUT_S = 900.0  #: for each set of tests; a test run that hangs counts as failed [s]


class Change(NamedTuple):
    """Replacement of one piece of a file."""

    kind: str
    file: str
    line: int
    start: int  #: offset in the file [bytes]
    end: int
    text: str


def _offsets(source: bytes) -> list[int]:
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    return starts


def changes(file: str, source: bytes) -> Iterator[Change]:
    """Yield all possible defects of a file."""
    starts = _offsets(source)

    def at(node: ast.AST) -> tuple[int, int]:
        assert isinstance(node, ast.expr)
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    def change(kind: str, node: ast.expr, start: int, end: int, text: str) -> Change:
        return Change(kind, file, node.lineno, start, end, text)

    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right) if not isinstance(
                left, ast.JoinedStr | ast.List | ast.Tuple
            ):
                start, end = at(left)[1], at(right)[0]
                sign, other = (b"+", "-") if isinstance(op, ast.Add) else (b"-", "+")
                where = source.find(sign, start, end)
                if where >= 0 and not _text(left) and not _text(right):
                    yield change("sign", node, where, where + 1, other)
            case ast.Compare(left=left, ops=[ast.Lt() | ast.Gt() | ast.LtE() | ast.GtE() as op], comparators=[right]):
                where = at(left)[1]
                gap = source[where : at(right)[0]]
                sign = {ast.Lt: "<", ast.Gt: ">", ast.LtE: "<=", ast.GtE: ">="}[type(op)]
                other = {"<": ">", ">": "<", "<=": ">=", ">=": "<="}[sign]
                found = gap.find(sign.encode())
                if found >= 0:
                    yield change("bound", node, where + found, where + found + len(sign), other)
            case ast.Constant(value=float() as value) if value not in (0.0, float("inf")):
                yield change("unit", node, *at(node), repr(1e3 * value))
            case ast.If(test=test, body=[ast.Raise(), *_], orelse=[]):
                yield change("dropped check", test, *at(test), "False")
            case ast.Subscript(slice=ast.Constant(value=int() as index) as where) if 0 <= index <= 2:
                yield change("axis", where, *at(where), str((index + 1) % 3))
            case _:
                pass


def _text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def chosen(count: int, seed: int, root: Path = ROOT) -> list[Change]:
    """Return defects of all rooms in turn."""
    random = np.random.default_rng(seed)
    rooms = dict[str, list[str]]()
    for path in sorted(root.glob("*/**/*.py")):
        name = path.relative_to(root).as_posix()
        if name.startswith(("core/", "station/", "web/")) and not name.startswith(SKIPPED):
            rooms.setdefault("/".join(name.split("/")[:2]), []).append(name)
    found, order = list[Change](), [room for room in rooms if not room.endswith(".py")]
    while len(found) < count:
        room = order[len(found) % len(order)]
        sizes = np.array([(root / name).stat().st_size for name in rooms[room]], np.float64)
        file = str(random.choice(rooms[room], p=sizes / sizes.sum()))
        possible = list(changes(file, (root / file).read_bytes()))
        if not possible:
            continue
        kinds = sorted({one.kind for one in possible})
        kind = str(random.choice(kinds))
        of_kind = [one for one in possible if one.kind == kind]
        found.append(of_kind[int(random.integers(len(of_kind)))])
    return found


def _sets(file: str, root: Path, *, whole: bool) -> Iterator[list[str]]:
    """Yield sets of tests, nearest first."""
    module, room = file.removesuffix(".py").removesuffix("/__init__").replace("/", "."), "/".join(file.split("/")[:2])
    parent, _, name = module.rpartition(".")
    tests = [path for path in sorted((root / "tests").rglob("test_*.py")) if "live" not in path.parts]
    tests = [path for path in tests if "thorough" not in path.parts]
    texts = {path: path.read_text(encoding="utf-8") for path in tests}
    near = [
        path for path in tests if f"{module} import" in texts[path] or f"from {parent} import {name}" in texts[path]
    ]
    yield [path.relative_to(root).as_posix() for path in near]
    yield [f"tests/{kind}/{room}" for kind in ("unit", "virtual") if (root / "tests" / kind / room).is_dir()]
    yield ["tests/golden"]
    if whole:
        yield ["tests/unit", "tests/virtual", "tests/live/test_smoke.py"]


def first_failure(tests: Sequence[str], root: Path) -> str:
    """Return the first failed test of a set; empty: all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-n", "0", "-p", "no:cacheprovider", *tests]
    try:
        answer = subprocess.run(
            command, cwd=root, capture_output=True, text=True, timeout=TIMEOUT_S, env=os.environ | {"COLUMNS": "200"},
            check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "no end"
    if answer.returncode in (0, 5):  # 5: no tests
        return ""
    failed = [line for line in answer.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return failed[0].split(" - ")[0] if failed else f"exit {answer.returncode}"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description="Break the product at random places and run its tests.")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="numbers of defects, with commas; default: all")
    parser.add_argument("--whole", action="store_true", help="run the whole default set if no nearer test fails")
    asked = parser.parse_args()
    numbers = [int(number) for number in asked.only.split(",") if number] or range(asked.count)
    found = chosen(asked.count, asked.seed)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".git", ".venv", "runs", "dist"))
        for number in numbers:
            one = found[number]
            path = copy / one.file
            source = path.read_bytes()
            path.write_bytes(source[: one.start] + one.text.encode() + source[one.end :])
            try:
                failed = next(
                    filter(None, (first_failure(s, copy) for s in _sets(one.file, copy, whole=asked.whole) if s)), ""
                )
            finally:
                path.write_bytes(source)
            was = source[one.start : one.end].decode()
            place = f"{one.file}:{one.line}: {one.kind}: {was!r} -> {one.text!r}"
            print(f"{number} {'found by ' + failed if failed else 'NOT FOUND'}: {place}", flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
