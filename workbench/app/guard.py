"""Access control of the live view, for the browser with its address.

The page listens on this computer's loopback interface, which every user and every web page opened on this computer can
reach. So each request, and the opening of each websocket, must

* name this address as its host: a foreign name that resolves to 127.0.0.1 is refused (DNS rebinding);
* come from a page of this address, if the browser states the origin: a foreign page is refused;
* have the token of the printed address: in its own address, or later in a cookie, which is set here.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from aiohttp.web import Application, Request, StreamResponse

    Handler = Callable[[Request], Awaitable[StreamResponse]]

#: The only interface of the page.
HOST = "127.0.0.1"

#: Content policy of the page: its own server, and embedded pictures. Vue compiles its templates to functions, which
#: needs the two kinds of script; nothing comes from outside.
_POLICY = ("default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
           "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; frame-ancestors 'none'; "
           "form-action 'none'; base-uri 'self'")


def new_token() -> str:
    """A random token for an address."""
    return secrets.token_urlsafe(24)


def address(port: int, token: str) -> str:
    """The address that opens the page."""
    return f"http://{HOST}:{port}/index.html?token={token}"


def cookie_name(port: int) -> str:
    """The name of a port's cookie. All ports of a host share cookies."""
    return f"workbench_{port}"


def protect(application: Application, token: str) -> None:
    """Make `application` refuse unauthorised requests with status 403. Call it before the application starts."""
    from aiohttp import web

    @web.middleware
    async def check(request: Request, handler: Handler) -> StreamResponse:
        wrong = refusal(request, token)
        if wrong:
            raise web.HTTPForbidden(text=f"refused: {wrong}\n")
        response = await handler(request)
        if "token" in request.query and not response.prepared:
            response.set_cookie(cookie_name(_port(request)), token, httponly=True, samesite="Strict", path="/")
        return response

    async def add_headers(_request: Request, response: StreamResponse) -> None:
        response.headers["Content-Security-Policy"] = _POLICY
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["X-Content-Type-Options"] = "nosniff"

    # The first of all middlewares.
    application.middlewares.insert(0, check)
    application.on_response_prepare.append(add_headers)


def refusal(request: Any, token: str) -> str:
    """The reason why a request is refused, or ""."""
    port = _port(request)
    host = f"{HOST}:{port}"
    if len(request.headers.getall("Host", [])) != 1 or request.headers["Host"].lower() != host:
        return f"a foreign host; open the address that was printed, which begins with http://{host}/"
    origins = request.headers.getall("Origin", [])
    if any(origin.lower() != f"http://{host}" for origin in origins):
        return "a foreign origin"
    # A wrong token in the address is refused, even with a valid cookie.
    given = request.query.getall("token", []) or [request.cookies.get(cookie_name(port), "")]
    if len(given) != 1 or not hmac.compare_digest(given[0].encode(), token.encode()):
        return "no token, or a wrong one; open the address that was printed"
    return ""


def _port(request: Any) -> int:
    return int(request.transport.get_extra_info("sockname")[1])
