"""The web application: the page, the live socket, past runs. Every request passes the guard first."""

from __future__ import annotations

import asyncio
import hashlib
import secrets
import threading
from collections.abc import Awaitable, Callable, MutableMapping
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

import msgspec
import structlog
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import FileResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from mdb_deploy.web.guard import Guard, RefusedError, Rights
from mdb_deploy.web.live import orders
from mdb_deploy.web.live.fan import Fan
from mdb_deploy.web.live.visitor import Visitor
from mdb_deploy.web.runs import BusyError, NoRunError, PastRuns
from mdb_protocol.errors import MdbError
from mdb_protocol.words import shown

if TYPE_CHECKING:
    from mdb_deploy.web.live.bridge import Bridge
    from mdb_deploy.web.live.finding import Found
    from mdb_deploy.web.live.guests import Guests
    from mdb_deploy.web.live.operator import Operator

log = structlog.get_logger()

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]

PAGE = Path(__file__).parent / "page"
KINDS = {
    ".html": "text/html; charset=utf-8", ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8", ".mjs": "text/javascript; charset=utf-8",
    ".json": "application/json", ".svg": "image/svg+xml", ".png": "image/png", ".ico": "image/x-icon",
    ".woff2": "font/woff2", ".txt": "text/plain; charset=utf-8", ".md": "text/plain; charset=utf-8",
}  # fmt: skip
"""What of the page's folder is served, and as what; the system's own list is not asked, for it may be another."""
IMAGES = {".png": "image/png"}
MOST_VISITORS = 64
MOST_ITERATION = 2**53
TICK_S = 0.05
COOKIE_S = 30 * 24 * 3600
NOT_FOUND = "there is nothing of this name here"


class Console:
    """The application, `app`, and who is there."""

    def __init__(self, guard: Guard, fan: Fan, runs: Path | None) -> None:
        """`runs`: the folder of past runs."""
        self.guard, self._fan = guard, fan
        self._past = PastRuns(runs)
        self._bridge: Bridge | None = None
        self._guests: Guests | None = None
        self._operator: Operator | None = None
        self._credentials: Path | None = None
        self._another = threading.Event()
        self._visitors: set[Visitor] = set()
        self._files: dict[str, tuple[tuple[int, int], bytes, str]] = {}
        routes = [
            Route("/", self._index),
            Route("/page/{path:path}", self._page),
            Route("/runs", self._runs),
            Route("/runs/{name}/hello", self._hello),
            Route("/runs/{name}/rows", self._rows),
            Route("/runs/{name}/at/{iteration:int}", self._at),
            Route("/runs/{name}/picture/{iteration:int}", self._picture),
            Route("/runs/{name}/files", self._list),
            Route("/runs/{name}/files/{path:path}", self._file),
            WebSocketRoute("/live", self._live),
        ]
        self._inner = Starlette(routes=routes)

    def attach(self, bridge: Bridge, guests: Guests, credentials: Path | None) -> None:
        """Take what joins the brain, which is there a moment later than the page; before the bridge starts.

        `credentials`: what the operator shows to the router.
        """
        self._bridge, self._guests, self._credentials = bridge, guests, credentials
        bridge.on_found = self._another.set

    async def app(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let in who may come in, and say of each answer what its page may do."""
        if scope["type"] not in ("http", "websocket"):
            return
        asked = HTTPConnection(scope)
        try:
            if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD"):
                raise RefusedError("this page is read; what it orders goes over its socket")
            host = self.guard.check_host(asked.headers.get("host"))
            self.guard.check_origin(asked.headers.get("origin"), host)
            token = parse_qs(asked.url.query).get("token", [None])[0]
            scope["rights"] = self.guard.rights(token, asked.headers.get("cookie"))
        except RefusedError as error:
            await _refuse(scope, receive, send, str(error))
            return
        headers = [(name.lower().encode(), value.encode()) for name, value in self.guard.headers(host).items()]
        if scope["type"] == "http":
            headers += self._cookies(asked, token)

        async def send_with(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *headers]
            await send(message)

        if scope["type"] == "http" and token is not None:
            await RedirectResponse(asked.url.path, 303)(scope, receive, send_with)  # out of the address and history
            return
        await self._inner(scope, receive, send_with)

    def _cookies(self, asked: HTTPConnection, token: str | None) -> list[tuple[bytes, bytes]]:
        """Return cookies to be kept: the link's token, and by what this browser is known again."""
        secure = "; Secure" if self.guard.site.encrypted else ""
        rules = f"; Path=/; HttpOnly; SameSite=Lax{secure}"
        cookies = []
        if token is not None and self.guard.role_of(token) is not None:
            cookies.append(f"{self.guard.cookie}={token}; Max-Age={COOKIE_S}{rules}")
        if asked.url.path == "/" and not asked.cookies.get(self._browser_cookie):
            cookies.append(f"{self._browser_cookie}={secrets.token_urlsafe(16)}{rules}")
        return [(b"set-cookie", cookie.encode()) for cookie in cookies]

    @property
    def _browser_cookie(self) -> str:
        return f"{self.guard.cookie}-browser"

    # ---- the page

    async def _index(self, request: Request) -> Response:
        return self._static(request, "index.html")

    async def _page(self, request: Request) -> Response:
        return self._static(request, request.path_params["path"])

    def _static(self, request: Request, path: str) -> Response:
        """Return a file of the page's folder; the browser asks each time whether it is another."""
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

    # ---- past runs

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

    # ---- the live socket

    async def _live(self, socket: WebSocket) -> None:
        if len(self._visitors) >= MOST_VISITORS:
            words = f"{MOST_VISITORS} browsers are here already; no more can be"
            await socket.send_denial_response(PlainTextResponse(words, 503))
            return
        browser = socket.cookies.get(self._browser_cookie) or secrets.token_urlsafe(16)
        visitor = Visitor(socket, socket.scope["rights"], browser, self._fan)
        self._visitors.add(visitor)  # before anything is waited for: the bound holds
        try:
            await socket.accept()
            if self._guests is not None:
                self._guests.back(visitor)
            await visitor.stay(lambda text: self._order(visitor, text), lambda sound: self._sound(visitor, sound))
        finally:
            self._visitors.discard(visitor)
            if self._guests is not None:
                self._guests.gone(visitor)

    async def _order(self, visitor: Visitor, text: str) -> None:
        """Do what a page asks for, and answer, whatever happens."""
        what = orders.what_of(text)
        try:
            words = await self._do(visitor, orders.read(text))
        except MdbError as error:
            visitor.answer(what, str(error), ok=False)
        except Exception as error:
            log.exception("an order failed", order=what)
            visitor.answer(what, f"the console failed at this: {type(error).__name__}", ok=False)
        else:
            visitor.answer(what, words, ok=True)

    async def _do(self, visitor: Visitor, order: orders.ALL) -> str:
        _check_rights(visitor.may, order)
        bridge, guests = self._bridge, self._guests
        found, hub = (bridge.found, bridge.hub) if bridge is not None else (None, None)
        if guests is not None and isinstance(order, orders.Leave):
            return await guests.leave(visitor)
        if guests is None or found is None or hub is None:
            raise MdbError("no brain is there now; wait until it is")
        if isinstance(order, orders.Join):
            return await guests.join(visitor, order, found)
        if isinstance(order, orders.TEACHING):
            return guests.obey(visitor, order)
        operator = self._operate(found)
        if isinstance(order, orders.ChangeRobot):
            return await asyncio.to_thread(operator.change, order.settings)
        await asyncio.to_thread(operator.control, order, lambda: hub.control, hub.iteration)
        return "done"

    def _operate(self, found: Found) -> Operator:
        from mdb_deploy.web.live.operator import Operator

        if self._operator is None:
            self._operator = Operator(found, self._credentials)
        return self._operator

    def _sound(self, visitor: Visitor, samples: bytes) -> None:
        try:
            if not visitor.may.teach:
                raise MdbError("this link lets you watch; for this you need the teacher's link")
            if self._guests is None:
                raise MdbError("no brain is there now; wait until it is")
            self._guests.sound(visitor, samples)
        except MdbError as error:
            visitor.answer("microphone", str(error), ok=False)

    # ---- all along

    async def tell(self) -> None:
        """Tell those who teach of their lessons, until cancelled."""
        assert self._guests is not None, "attached before"
        for visitor in self._visitors:
            self._guests.back(visitor)
        while True:
            try:
                if self._another.is_set():
                    self._another.clear()
                    await self.leave("another run is shown now")
                self._guests.tick()
            except Exception:
                log.exception("telling of lessons failed")
            await asyncio.sleep(TICK_S)

    async def leave(self, why: str = "the console ends") -> None:
        """End all lessons, and leave the router."""
        if self._guests is not None:
            await self._guests.close(why)
        operator, self._operator = self._operator, None
        if operator is not None:
            await asyncio.to_thread(operator.close)

    async def close(self) -> None:
        """Let go of what is open."""
        self._past.close()


def _check_rights(rights: Rights, order: orders.ALL) -> None:
    """Raise MdbError when a visitor's link does not let him order this."""
    operates = isinstance(order, orders.OPERATING)
    if not (rights.operate if operates else rights.teach):
        role = "operator" if operates else "teacher"
        raise MdbError(f"this link lets you watch; for this you need the {role}'s link")


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


async def _refuse(scope: Scope, receive: Receive, send: Send, words: str) -> None:
    """Answer 403 with words, to a request for a socket too."""
    response = PlainTextResponse(words, 403)
    if scope["type"] == "websocket":
        await WebSocket(scope, receive, send).send_denial_response(response)
    else:
        await response(scope, receive, send)
