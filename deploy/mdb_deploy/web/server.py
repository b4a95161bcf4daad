"""The web application: the page, the live socket, past runs. Every request passes the guard first."""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections.abc import Awaitable, Callable, MutableMapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs

import structlog
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from mdb_deploy.web.archive import Archive
from mdb_deploy.web.guard import Guard, RefusedError, Rights
from mdb_deploy.web.live import orders
from mdb_deploy.web.live.fan import Fan
from mdb_deploy.web.live.visitor import Visitor
from mdb_deploy.web.static import PageFiles
from mdb_protocol.errors import MdbError

if TYPE_CHECKING:
    from mdb_deploy.web.live.bridge import Bridge
    from mdb_deploy.web.live.finding import Found
    from mdb_deploy.web.live.guests import Guests
    from mdb_deploy.web.live.hub import Hub
    from mdb_deploy.web.live.operator import Operator

log = structlog.get_logger()

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]

MOST_VISITORS = 64
TICK_S = 0.05
COOKIE_S = 30 * 24 * 3600


class Console:
    """The application, `app`, and who is there."""

    def __init__(self, guard: Guard, fan: Fan, runs: Path | None) -> None:
        """`runs`: the folder of past runs."""
        self.guard, self._fan = guard, fan
        self._archive = Archive(runs)
        self._bridge: Bridge | None = None
        self._guests: Guests | None = None
        self._operator: Operator | None = None
        self._credentials: Path | None = None
        self._kept: Hub | None = None
        """The hub since which it was looked at whether somebody says how the run goes on."""
        self._keeping: asyncio.Task[None] | None = None
        self._another = threading.Event()
        self._visitors: set[Visitor] = set()
        self._files = PageFiles()
        routes = [
            Route("/", self._index),
            Route("/page/{path:path}", self._page),
            *self._archive.routes,
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
            path = "/" + asked.url.path.lstrip("/")  # two of them would begin another site's address
            await RedirectResponse(path, 303)(scope, receive, send_with)  # out of the address and history
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
        return self._files.answer(request, "index.html")

    async def _page(self, request: Request) -> Response:
        return self._files.answer(request, request.path_params["path"])

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
        await asyncio.to_thread(operator.control, order, hub)
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
                self._keep_control()
            except Exception:
                log.exception("telling of lessons failed")
            await asyncio.sleep(TICK_S)

    def _keep_control(self) -> None:
        """See to it that who comes late hears how the run goes on, and hears it from who said it last."""
        hub, found = (self._bridge.hub, self._bridge.found) if self._bridge is not None else (None, None)
        if hub is None or found is None or (self._keeping is not None and not self._keeping.done()):
            return
        operator = self._operator
        if operator is not None and hub.hears_control and operator.is_behind(hub.control):
            self._keeping = asyncio.create_task(asyncio.to_thread(operator.leave))
        elif hub is not self._kept and hub.nobody_controls:
            self._kept = hub
            if found.run is not None and hub.control.is_usual:
                return
            self._keeping = asyncio.create_task(self._say_again(self._operate(found), hub))

    async def _say_again(self, operator: Operator, hub: Hub) -> None:
        try:
            await asyncio.to_thread(operator.keep, hub)
        except MdbError as error:  # the router is gone again, or these keys may not
            log.info("how the run goes on is not said again", reason=str(error))

    async def leave(self, why: str = "the console ends") -> None:
        """End all lessons, and leave the router."""
        if self._guests is not None:
            await self._guests.close(why)
        operator, self._operator = self._operator, None
        if operator is not None:
            await asyncio.to_thread(operator.close)

    async def close(self) -> None:
        """Let go of what is open."""
        self._archive.close()


def _check_rights(rights: Rights, order: orders.ALL) -> None:
    """Raise MdbError when a visitor's link does not let him order this."""
    operates = isinstance(order, orders.OPERATING)
    if not (rights.operate if operates else rights.teach):
        role = "operator" if operates else "teacher"
        raise MdbError(f"this link lets you watch; for this you need the {role}'s link")


async def _refuse(scope: Scope, receive: Receive, send: Send, words: str) -> None:
    """Answer 403 with words, to a request for a socket too."""
    response = PlainTextResponse(words, 403)
    if scope["type"] == "websocket":
        await WebSocket(scope, receive, send).send_denial_response(response)
    else:
        await response(scope, receive, send)
