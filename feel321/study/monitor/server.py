"""A page on this machine alone: loopback, a secret in its address, and nothing but reading unless it may send acts.

Other programs on the machine do not know the token, and other sites cannot ask through the browser: their `Host` is
refused (DNS rebinding), and no header lets them read an answer.
"""

from __future__ import annotations

import hmac
import secrets
import socket
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

INSTALL = "install it from feel321's source folder: pip install -c constraints.txt '.[monitor]'"

LOOPBACK = {"127.0.0.1": socket.AF_INET, "localhost": socket.AF_INET, "::1": socket.AF_INET6}
"""Hosts that no other machine reaches."""

READING = ["GET", "HEAD"]

Answer = Callable[[str, Mapping[str, str]], tuple[str, str]]
"""Makes a page of the nonce of its scripts and of the query: its media type and text."""

Act = Callable[[bytes], None]
"""Takes what a page sends."""

MOST_BYTES = 4096
"""How long what a page sends may be."""

HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}

POLICY = (
    "default-src 'none'; connect-src 'self'; img-src data:; media-src data:; style-src 'unsafe-inline'; "
    "script-src 'nonce-{nonce}'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def open_socket(host: str, port: int) -> socket.socket:
    """Bind to a port of this machine, a free one for 0."""
    if host not in LOOPBACK:
        raise ValueError(
            f"--host must be one of {', '.join(LOOPBACK)}, which no other machine reaches, got {host}; from another "
            "machine use a tunnel: ssh -L 8321:127.0.0.1:PORT LAB"
        )
    bound = socket.socket(LOOPBACK[host], socket.SOCK_STREAM)
    try:
        bound.bind((host, port))
    except OSError as error:
        bound.close()
        raise OSError(
            f"--port {port}: {error.strerror}; choose another, or leave it out for a free one"
        ) from None
    return bound


@dataclass(frozen=True, slots=True)
class Door:
    """Lets in who knows the token; host, port: where it listens."""

    host: str
    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    @property
    def address(self) -> str:
        """The address of the page, with its token."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/?token={self.token}"

    def refuse(self, request: Request) -> str:
        """Say why a request is refused; empty if it is not."""
        hosts = {f"{name}:{self.port}" for name in ("127.0.0.1", "localhost", "[::1]")}
        if request.headers.get("host", "").lower() not in hosts:
            return "this page answers on the loopback address only"
        given = request.query_params.get("token", "").encode()
        if not hmac.compare_digest(given, self.token.encode()):
            return "the token is missing or wrong; open the address that the terminal shows"
        return ""


async def _take_body(request: Request, take: Act) -> int:
    """Take what a page sends unless it is longer than any page's; returns the status."""
    body = b""
    async for chunk in request.stream():
        if len(body := body + chunk) > MOST_BYTES:
            return 413
    take(body)
    return 204


def make_app(door: Door, pages: Mapping[str, Answer], acts: Mapping[str, Act]) -> Starlette:
    """Make a site of pages and of what they may send, by path."""
    from starlette.applications import Starlette
    from starlette.responses import Response
    from starlette.routing import Route

    def serve(make: Answer) -> Callable[[Request], Response]:
        def answer(request: Request) -> Response:
            if reason := door.refuse(request):
                return Response(f"{reason}\n", 403, HEADERS, "text/plain")
            nonce = secrets.token_urlsafe(16)
            media_type, text = make(nonce, request.query_params)
            policy = {"Content-Security-Policy": POLICY.format(nonce=nonce)}
            return Response(text, 200, HEADERS | policy, media_type)

        return answer

    def receive(take: Act) -> Callable[[Request], Awaitable[Response]]:
        async def answer(request: Request) -> Response:
            if reason := door.refuse(request):
                return Response(f"{reason}\n", 403, HEADERS, "text/plain")
            return Response(None, await _take_body(request, take), HEADERS)

        return answer

    def refuse(_request: Request, _error: Exception) -> Response:
        return Response("not here\n", 403, HEADERS, "text/plain")

    routes = [Route(path, serve(make), methods=READING) for path, make in pages.items()]
    routes += [Route(path, receive(take), methods=["POST"]) for path, take in acts.items()]
    # Without the token nobody learns which paths there are.
    app = Starlette(routes=routes, exception_handlers={404: refuse, 405: refuse})
    # A redirect would come before the check, and repeat the Host.
    app.router.redirect_slashes = False
    return app


def serve_pages(
    host: str,
    port: int,
    pages: Mapping[str, Answer],
    *,
    announce: Callable[[str], None],
    acts: Mapping[str, Act] | None = None,
) -> None:
    """Serve pages until Ctrl-C; announce: called with the address."""
    try:
        import uvicorn
    except ImportError:
        raise OSError(
            f"uvicorn and starlette not found, which this page needs; {INSTALL}"
        ) from None
    with open_socket(host, port) as bound:
        door = Door(host, bound.getsockname()[1])
        config = uvicorn.Config(
            make_app(door, pages, acts or {}),
            log_config=None,
            access_log=False,
            lifespan="off",
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        bound.listen()
        announce(door.address)
        uvicorn.Server(config).run(sockets=[bound])
