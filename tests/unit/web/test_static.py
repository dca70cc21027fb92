"""Checks of the static files of the page."""

import re
from pathlib import Path

import pytest
from starlette.testclient import TestClient

import web

MODULES = sorted((Path(web.__file__).parent / "static").rglob("*.js")) if web.__file__ else []


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.name)
def test_no_module_opens_a_modal_dialog_that_blocks_stop(module: Path) -> None:
    """A modal dialog and a browser's question block STOP for mouse, touch and keyboard."""
    assert not re.search(r"showModal|\b(alert|prompt)\(|window\.confirm|requestFullscreen", module.read_text())


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.name)
def test_every_number_is_entered_in_the_one_component_for_numbers(module: Path) -> None:
    """A number field of the browser drops characters, for example the comma of 0,5."""
    assert not re.search(r"type: \"number\"|type=.number|valueAsNumber", module.read_text(encoding="utf-8"))


def test_page_reads_only_schemas_and_paths_of_the_api(app: TestClient) -> None:
    """A form whose schema has another name would leave its tab empty."""
    text = "\n".join(module.read_text(encoding="utf-8") for module in MODULES)
    api = app.get("/api/openapi.json").json()
    schemas = set(re.findall(r"\b(?:all|schemas\(\)\))\.([A-Z]\w+)", text))
    assert len(schemas) >= 2
    # Schema and path of stations that follow targets, a WebSocket, and the description itself are not described here.
    assert schemas - {"StreamAgreement"} <= api["components"]["schemas"].keys()
    known = [
        *api["paths"],
        "/api/setpoints",
        "/api/stop/socket",
        "/api/gateway/target",
        "/api/openapi.json",
        "/api/docs",
    ]
    paths = set(re.findall(r"[\"`](/api/[^\"`?]*)", text))
    assert len(paths) > 15
    patterns = {path: re.compile(re.sub(r"\$\{[^}]*\}", "[^/]+", path)) for path in paths}
    assert [path for path in sorted(paths) if not any(patterns[path].fullmatch(one) for one in known)] == []
