"""Files of the page: its document, which contains STOP and preloads every module, and files that a browser checks."""

import base64
import hashlib
from os import PathLike, stat_result
from pathlib import Path

from fastapi.responses import HTMLResponse
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

STATIC = Path(__file__).parent / "static"
#: Content-Security-Policy of the page, which may load only files of the station. The scene has a separate page.
CONTENT_POLICY = (
    "default-src 'self'; script-src 'self' '{stop}'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline';"
    " frame-ancestors 'self'"
)
#: Script that is part of the document, so that STOP works without any other file.
STOP_SCRIPT = "page/stop.js"
#: A browser may store a file, but must check whether it has changed. Without this header a browser uses old modules for
#: hours after an update of the station.
CHECK_BEFORE_USE = {"cache-control": "no-cache"}


def page() -> HTMLResponse:
    """Return the page's document with the script of STOP and a preload of every module.

    Modules import each other, so a browser would find the last ones only after several round trips. The document is
    read at each request, so that a changed module needs no restart of the station.
    """
    modules = sorted(path.relative_to(STATIC).as_posix() for path in STATIC.rglob("*.js"))
    modules.remove(STOP_SCRIPT)
    preloads = "".join(f'<link rel="modulepreload" href="/static/{module}">\n' for module in modules)
    stop = (STATIC / STOP_SCRIPT).read_text(encoding="utf-8")
    document = (STATIC / "index.html").read_text(encoding="utf-8").replace("</head>", f"{preloads}</head>", 1)
    document = document.replace(f'<script src="/static/{STOP_SCRIPT}"></script>', f"<script>{stop}</script>", 1)
    digest = base64.b64encode(hashlib.sha256(stop.encode()).digest()).decode()
    policy = CONTENT_POLICY.format(stop=f"sha256-{digest}")
    return HTMLResponse(document, headers={**CHECK_BEFORE_USE, "content-security-policy": policy})


class CheckedFiles(StaticFiles):
    """Static files that a browser checks before each use; an unchanged file is answered without its content."""

    def file_response(
        self, full_path: str | PathLike[str], stat_result: stat_result, scope: Scope, status_code: int = 200
    ) -> Response:
        """Return the file, or a response without content if the file has not changed."""
        response = super().file_response(full_path, stat_result, scope, status_code)
        response.headers.update(CHECK_BEFORE_USE)
        return response
