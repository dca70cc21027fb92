"""The page's own files."""

import re
from pathlib import Path

import pytest

import web

MODULES = sorted((Path(web.__file__).parent / "static").glob("*.js")) if web.__file__ else []


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.name)
def test_no_module_opens_what_makes_the_header_inert(module: Path) -> None:
    """A modal dialog, and a browser's own question, take STOP away from mouse, touch and keyboard."""
    assert not re.search(r"showModal|\b(alert|prompt)\(|window\.confirm|requestFullscreen", module.read_text())
