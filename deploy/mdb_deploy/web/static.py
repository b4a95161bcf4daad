"""The page's own files, as browsers want them: each is asked for anew, and sent again only when it is another."""

from __future__ import annotations

import hashlib
from pathlib import Path, PurePosixPath

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

PAGE = Path(__file__).parent / "page"
KINDS = {
    ".html": "text/html; charset=utf-8", ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8", ".mjs": "text/javascript; charset=utf-8",
    ".json": "application/json", ".svg": "image/svg+xml", ".png": "image/png", ".ico": "image/x-icon",
    ".woff2": "font/woff2", ".txt": "text/plain; charset=utf-8", ".md": "text/plain; charset=utf-8",
}  # fmt: skip
"""What of the page's folder is served, and as what; the system's own list is not asked, for it may be another."""
NOT_FOUND = "there is nothing of this name here"


class PageFiles:
    """See the module's docstring. Keeps each file's content until the file is another."""

    def __init__(self) -> None:
        self._files: dict[str, tuple[tuple[int, int], bytes, str]] = {}

    def answer(self, request: Request, path: str) -> Response:
        """Return the answer to a request for a file."""
        kept = self._read(path)
        if kept is None:
            return PlainTextResponse(NOT_FOUND, 404)
        content, tag, kind = kept
        headers = {"ETag": tag, "Cache-Control": "no-cache"}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        return Response(content, headers=headers, media_type=kind)

    def _read(self, path: str) -> tuple[bytes, str, str] | None:
        parts = path.split("/")
        kind = KINDS.get(PurePosixPath(path).suffix)
        if kind is None or any(part in ("", ".", "..") or "\0" in part for part in parts):
            return None
        file = PAGE.joinpath(*parts)
        try:
            seen = file.stat()
            mark = (seen.st_mtime_ns, seen.st_size)
            if (kept := self._files.get(path)) is None or kept[0] != mark:
                content = file.read_bytes()
                kept = (mark, content, f'"{hashlib.sha256(content).hexdigest()[:24]}"')
                self._files[path] = kept
        except OSError:
            return None
        return kept[1], kept[2], kind
