"""Every name that a file of the project imports from another one exists, also where a test is run late."""

import ast
from functools import cache
from pathlib import Path

from tests.harness.root import ROOT

ROOMS = ("core", "station", "web", "tests")


@cache
def nodes(file: Path) -> list[ast.AST]:
    return list(ast.walk(ast.parse(file.read_text(encoding="utf-8"))))


@cache
def names_in(file: Path) -> frozenset[str]:
    """Return the names that a file binds, in any of its blocks."""
    found = set[str]()
    for node in nodes(file):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {(alias.asname or alias.name).split(".")[0] for alias in node.names}
    return frozenset(found)


def has(module: str, name: str) -> bool:
    place = ROOT.joinpath(*module.split("."))
    if place.is_dir():
        start = place / "__init__.py"
        parts = (place / name, place / f"{name}.py")
        return any(part.exists() for part in parts) or (start.exists() and name in names_in(start))
    return place.with_suffix(".py").exists() and name in names_in(place.with_suffix(".py"))


def test_every_name_that_is_imported_from_the_project_exists() -> None:
    missing = [
        f"{file.relative_to(ROOT)}:{node.lineno}: {node.module} has no {alias.name}"
        for room in ROOMS
        for file in (ROOT / room).rglob("*.py")
        for node in nodes(file)
        if isinstance(node, ast.ImportFrom) and not node.level and node.module and node.module.split(".")[0] in ROOMS
        for alias in node.names
        if not has(node.module, alias.name)
    ]
    assert missing == []
