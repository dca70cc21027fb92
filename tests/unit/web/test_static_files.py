"""The page's files: compressed, checked by the browser before each use, and found without round trips."""

import base64
import hashlib
import re

from starlette.testclient import TestClient

from web.static_files import STATIC, STOP_SCRIPT

MODULES = sorted(path.relative_to(STATIC).as_posix() for path in STATIC.rglob("*.js"))
MODULES.remove(STOP_SCRIPT)


def test_the_page_preloads_every_module_once_and_no_other_file(app: TestClient) -> None:
    document = app.get("/").text

    assert re.findall(r'<link rel="modulepreload" href="/static/([^"]+)">', document) == MODULES
    assert "main.js" in MODULES
    assert document.index("modulepreload") < document.index("</head>")


def test_stop_is_in_the_document_before_every_other_file_and_only_files_of_the_station_are_allowed(
    app: TestClient,
) -> None:
    answer = app.get("/")
    scripts = re.findall(r"<script>(.*?)</script>", answer.text, re.DOTALL)

    assert scripts == [(STATIC / STOP_SCRIPT).read_text(encoding="utf-8")]
    assert answer.text.index("<script>") < answer.text.index("<link")
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    policy = answer.headers["content-security-policy"]
    assert policy.startswith(f"default-src 'self'; script-src 'self' 'sha256-{digest}';")
    assert "http" not in policy


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
