"""What is asked of past runs over HTTP: the list of them, each one's parts at a moment, its files."""

from __future__ import annotations

from collections.abc import Awaitable
from pathlib import Path
from typing import Any

import msgspec
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Route

from mdb_deploy.web.guard import Rights
from mdb_deploy.web.runs import BusyError, NoRunError, PastRuns
from mdb_protocol.errors import MdbError
from mdb_protocol.words import shown

IMAGES = {".png": "image/png"}
"""What a browser may show; all else is downloaded."""
MOST_ITERATION = 2**53


class Archive:
    """See the module's docstring."""

    def __init__(self, runs: Path | None) -> None:
        """`runs`: the folder of past runs; None: there are none."""
        self._past = PastRuns(runs)
        self.routes = [
            Route("/runs", self._runs),
            Route("/runs/{name}/hello", self._hello),
            Route("/runs/{name}/rows", self._rows),
            Route("/runs/{name}/at/{iteration:int}", self._at),
            Route("/runs/{name}/picture/{iteration:int}", self._picture),
            Route("/runs/{name}/files", self._list),
            Route("/runs/{name}/files/{path:path}", self._file),
        ]

    def close(self) -> None:
        """Free what is open."""
        self._past.close()

    async def _runs(self, _: Request) -> Response:
        return await _answer(self._past.runs())

    async def _hello(self, request: Request) -> Response:
        rights: Rights = request.scope["rights"]

        def greeting(run: Any) -> dict[str, Any]:
            return {**run.hello(), "rights": rights._asdict()}

        return await _answer(self._past.ask(request.path_params["name"], greeting))

    async def _rows(self, request: Request) -> Response:
        return await _answer(self._past.ask(request.path_params["name"], lambda run: run.rows()))

    async def _at(self, request: Request) -> Response:
        iteration = min(request.path_params["iteration"], MOST_ITERATION)
        picture = "picture" in request.query_params
        return await _answer(
            self._past.ask(request.path_params["name"], lambda run: run.at(iteration, picture=picture))
        )

    async def _picture(self, request: Request) -> Response:
        iteration = min(request.path_params["iteration"], MOST_ITERATION)
        return await _answer(self._past.ask(request.path_params["name"], lambda run: run.picture(iteration)))

    async def _list(self, request: Request) -> Response:
        return await _answer(self._past.ask(request.path_params["name"], lambda run: run.files()))

    async def _file(self, request: Request) -> Response:
        try:
            path = self._past.file(request.path_params["name"], request.path_params["path"])
        except NoRunError as error:
            return PlainTextResponse(str(error), 404)
        kind = IMAGES.get(path.suffix, "application/octet-stream")
        return FileResponse(path, media_type=kind, filename=path.name)


async def _answer(asked: Awaitable[Any]) -> Response:
    """Return an answer as JSON, or in words why there is none."""
    try:
        content = await asked
    except NoRunError as error:
        return PlainTextResponse(str(error), 404)
    except BusyError as error:
        return PlainTextResponse(str(error), 503)
    except (MdbError, OSError) as error:
        return PlainTextResponse(shown(error, 1000), 422)
    return Response(
        msgspec.json.encode(content), media_type="application/json", headers={"Cache-Control": "no-cache"}
    )
