"""The page's files."""

import re
from pathlib import Path

import pytest

import web

MODULES = sorted((Path(web.__file__).parent / "static").glob("*.js")) if web.__file__ else []


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.name)
def test_no_module_opens_a_modal_dialog_that_blocks_stop(module: Path) -> None:
    """A modal dialog and a browser's question block STOP for mouse, touch and keyboard."""
    assert not re.search(r"showModal|\b(alert|prompt)\(|window\.confirm|requestFullscreen", module.read_text())
