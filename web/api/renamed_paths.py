"""Old paths of REST requests: the station answers with status 410 and the new path."""

from types import MappingProxyType

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse

from web.api.utf8_guard import refusal

#: New path of each old path that REST format 2 has renamed.
RENAMED_PATHS = MappingProxyType(
    {"/api/pull": "/api/load", "/api/try": "/api/waypoints/check", "/api/bench": "/api/rig"}
)
METHODS = ["GET", "POST", "PUT", "PATCH", "DELETE"]


def renamed_routes() -> APIRouter:
    """Return routes that answer every request to an old path with 410 and the new path."""
    router = APIRouter()
    for path in RENAMED_PATHS:
        router.add_api_route(path, gone, methods=METHODS, include_in_schema=False)
    return router


async def gone(request: Request) -> JSONResponse:
    """Return the answer to a request to an old path."""
    path = request.url.path
    return refusal(f"{path} was renamed in REST format 2: use {RENAMED_PATHS[path]}", 410)
