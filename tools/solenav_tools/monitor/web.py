"""The view in browsers: a page and, over a WebSocket, what is new ten times a second.

A browser that is slow gets less often what is newest; nothing is queued for it, and reading and
recording never wait for one. The page is on this machine alone unless another address is asked for;
then it needs the token that is printed. Host and Origin are looked at in any case, so that no other
page that somebody has open can listen in.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import ipaddress
import secrets
import socket
import time
from collections.abc import Callable, Sequence
from importlib import import_module, resources
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from solenav.errors import SolenavError
from solenav_tools.monitor.live import Point
from solenav_tools.monitor.watch import Watch

if TYPE_CHECKING:
    from starlette.applications import Starlette

EVERY_S = 0.1
_COOKIE = "solenav"
_TYPES = {
    "index.html": "text/html",
    "view.js": "text/javascript",
    "view.css": "text/css",
    "icon.svg": "image/svg+xml",
}
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; connect-src 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
_LOCAL = ("127.0.0.1", "localhost", "[::1]", "::1")


def serve(
    watches: Sequence[Watch],
    host: str,
    port: int,
    over: Callable[[], bool],
    tell: Callable[[str], None],
) -> None:
    """Serve the page until `over`. SolenavError where the address is taken or packages miss."""
    try:
        uvicorn: Any = import_module("uvicorn")
        import_module("starlette")
        import_module("websockets")
    except ImportError:
        raise SolenavError("the page needs more packages", "pip install 'solenav[web]'") from None
    local = _is_local(host)
    token = "" if local else secrets.token_urlsafe(16)
    listening = _listen(host, port)
    at = listening.getsockname()[1]
    shown = f"[{host}]" if ":" in host else host
    tell(f"http://{shown}:{at}/" + (f"?token={token}" if token else ""))
    if not local:
        tell("anybody who has this address with its token sees where the wearers are")
    config = uvicorn.Config(
        application(watches, token, at), log_level="warning", lifespan="off", ws="websockets-sansio"
    )
    server = uvicorn.Server(config)

    async def run() -> None:
        serving = asyncio.create_task(server.serve(sockets=[listening]))
        while not over() and not serving.done():
            await asyncio.sleep(EVERY_S)
        server.should_exit = True
        await serving

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(run())


def _is_local(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _listen(host: str, port: int) -> socket.socket:
    try:
        family, *_rest, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
        listening.listen()
        return listening
    except OSError as error:
        raise SolenavError(
            f"can't serve on {host}, port {port}: {error.strerror or error}",
            "choose another --http-port, or 0 for any",
        ) from None


def application(watches: Sequence[Watch], token: str, port: int) -> Starlette:
    """The server's pages. `token` "" serves only those who come by a name of this machine."""
    from starlette.applications import Starlette
    from starlette.requests import HTTPConnection, Request
    from starlette.responses import PlainTextResponse, RedirectResponse, Response
    from starlette.routing import Route, WebSocketRoute
    from starlette.websockets import WebSocket, WebSocketDisconnect

    def allowed(connection: HTTPConnection) -> bool:
        if not token:
            host = urlsplit(f"//{connection.headers.get('host', '')}")
            return host.hostname in _LOCAL and host.port in (port, None)
        given = connection.query_params.get("token") or connection.cookies.get(_COOKIE, "")
        return hmac.compare_digest(given.encode(), token.encode())

    def same_origin(connection: HTTPConnection) -> bool:
        origin = connection.headers.get("origin")
        return origin is not None and urlsplit(origin).netloc == connection.headers.get("host")

    async def page(request: Request) -> Response:
        if not allowed(request):
            return PlainTextResponse("the address needs its token", 403, _HEADERS)
        name = request.path_params.get("name", "index.html")
        if "token" in request.query_params:
            # Out of the address, so that it isn't passed on with a bookmark or a screenshot.
            answer: Response = RedirectResponse("/", 303, _HEADERS)
            answer.set_cookie(_COOKIE, token, httponly=True, samesite="strict")
            return answer
        if name not in _TYPES:
            return PlainTextResponse("there is no such page", 404, _HEADERS)
        content = (
            resources.files("solenav_tools.monitor").joinpath("page").joinpath(name).read_bytes()
        )
        return Response(content, media_type=_TYPES[name], headers=_HEADERS)

    async def feed(connection: WebSocket) -> None:
        if not allowed(connection) or not same_origin(connection):
            await connection.close(4403)
            return
        await connection.accept()
        readers = [Feed(watch) for watch in watches]
        with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):
            while True:
                now = time.monotonic()
                # Awaited: a browser that takes its time gets the next later, with all that came.
                await connection.send_json([reader.news(now) for reader in readers])
                await asyncio.sleep(EVERY_S)

    return Starlette(
        routes=[
            Route("/", page),
            WebSocketRoute("/feed", feed),
            Route("/{name}", page),
        ]
    )


class Feed:
    """What one browser has of one wearer, and so what is new for it."""

    def __init__(self, watch: Watch) -> None:
        self.watch = watch
        self._ways = -1
        self._sent = 0  # points of the way
        self._last = -1.0  # time of the last recent point that was sent

    def news(self, now: float) -> dict[str, Any]:
        """A message: the state, and the points since the last one; `reset` voids those before."""
        watch = self.watch
        with watch.lock:
            live = watch.live
            reset = live.ways != self._ways
            if reset:
                self._ways, self._sent = live.ways, 0
                self._last = -1.0
            way = live.way[self._sent :]
            self._sent = len(live.way)
            recent = []
            for point in reversed(live.recent):
                if point.time_s <= self._last:
                    break
                recent.append(point)
            recent.reverse()
            age = now - live.heard if live.frames else None
            state = {"stale": live.stale(now), "age": age, **live.as_dict()}
        if recent:
            self._last = recent[-1].time_s
        return {
            "name": watch.wearer.name,
            "colour": watch.wearer.colour,
            "unplugged": watch.gone,
            "recording": watch.recording,
            "trouble": watch.trouble,
            "reset": reset,
            "way": [_rounded(point) for point in way],
            "recent": [_rounded(point) for point in recent],
            **state,
        }


def _rounded(point: Point) -> list[float]:
    """time_s, east, north, up, speed, stance, n_eff, threshold, doubtful."""
    return [round(float(value), 3) for value in point]
