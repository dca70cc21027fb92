"""The page's files: compressed, checked by the browser before each use, and found without round trips."""

import re

from starlette.testclient import TestClient

from web.static_files import STATIC

MODULES = sorted(path.relative_to(STATIC).as_posix() for path in STATIC.rglob("*.js"))


def test_the_page_preloads_every_module_once_and_no_other_file(app: TestClient) -> None:
    document = app.get("/").text

    assert re.findall(r'<link rel="modulepreload" href="/static/([^"]+)">', document) == MODULES
    assert "main.js" in MODULES
    assert document.index("modulepreload") < document.index("</head>")


def test_the_page_may_load_only_files_of_the_station(app: TestClient) -> None:
    policy = app.get("/").headers["content-security-policy"]

    assert policy.startswith("default-src 'self';")
    assert "script-src" not in policy


def test_an_unchanged_module_is_answered_without_its_content(app: TestClient) -> None:
    first = app.get("/static/main.js")
    assert first.headers["cache-control"] == "no-cache"

    again = app.get("/static/main.js", headers={"if-none-match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["cache-control"] == "no-cache"


def test_large_texts_are_compressed_and_small_answers_are_not(app: TestClient) -> None:
    module = app.get("/static/page/station.js")
    assert module.headers["content-encoding"] == "gzip"
    assert int(module.headers["content-length"]) < 0.5 * len(module.content)
    assert "content-encoding" not in app.post("/api/stop", json={}).headers
    assert "content-encoding" not in app.get("/static/page/station.js", headers={"accept-encoding": "identity"}).headers
