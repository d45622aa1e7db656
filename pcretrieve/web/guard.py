"""What every request must satisfy before it is answered: its host, its origin, and the token.

Other programs of this computer, and pages of other sites in the browser of the user, can reach a server on
127.0.0.1. The token, which is printed once, keeps out those that were not given it. The names of the host are
checked because a foreign site can let its own name mean 127.0.0.1 (DNS rebinding), and the origin because a
browser sends the cookie with requests that pages of other ports of this computer make.
"""

from __future__ import annotations

import hmac
import time
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

#: Beginning of the name of the cookie; the port follows, because servers of one computer share cookies.
COOKIE = "pcretrieve-"

# The names by which a browser on the same computer, or at the end of an SSH tunnel, calls the server.
HOSTS = frozenset({"127.0.0.1", "localhost", "::1"})

SAFE_METHODS = frozenset({"GET", "HEAD"})

# Of all answers. Scripts, styles and pictures come from this server only, the typeface is in a style, nothing
# is written in a page, and no other page shows this one in a frame. Other sites are not told where a link
# was; this one is, because without a referrer browsers send forms with the origin null.
HEADERS = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "font-src data:; img-src 'self' data:; connect-src 'self'; form-action 'self'; "
    "base-uri 'none'; frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}


class Guard:
    """An ASGI application that hands on requests with the right host, origin and token, and no others."""

    def __init__(self, application: Application, token: str) -> None:
        self._application = application
        self._token = token.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] == "lifespan":
            await self._application(scope, receive, send)
            return
        if scope["type"] != "http":  # a WebSocket, of which there are none
            await receive()
            await send({"type": "websocket.close"})
            return
        send = _with_headers(send, time.perf_counter())
        headers = {
            name.decode("latin-1"): value.decode("latin-1")
            for name, value in scope["headers"]
        }
        host = headers.get("host", "")
        query = parse_qsl(scope["query_string"].decode("latin-1"), keep_blank_values=True)
        given = dict(query).get("token")
        refusal = self._refusal(scope["method"], host, headers, given)
        if refusal is not None:
            # Refused connections are closed, so that nobody without the token keeps one open.
            refused = {"content-type": "text/plain; charset=utf-8", "connection": "close"}
            await _sent(send, refusal[0], refused, refusal[1])
        elif given is not None and scope["method"] in SAFE_METHODS:
            rest = urlencode([pair for pair in query if pair[0] != "token"])
            # With one slash at the beginning, because two would be followed by the name of another host.
            path = "/" + scope["raw_path"].decode("latin-1").lstrip("/\\")
            # Not the token of the address, which may be wrong if the request has another that is right.
            cookie = (
                f"{COOKIE}{_name_and_port(host)[1]}={self._token.decode()}"
                "; Path=/; HttpOnly; SameSite=Strict"
            )
            await _sent(
                send,
                303,
                {"location": f"{path}?{rest}" if rest else path, "set-cookie": cookie},
                "",
            )
        else:
            raw = {**scope, "path": scope["raw_path"].decode("latin-1")}
            await self._application(raw, receive, send)

    def _refusal(
        self, method: str, host: str, headers: dict[str, str], given: str | None
    ) -> tuple[int, str] | None:
        """The status and the words of a request that is not answered."""
        if _name_and_port(host)[0] not in HOSTS:
            return (
                400,
                "This server answers at 127.0.0.1 and localhost only: use the address it printed.\n",
            )
        origin = headers.get("origin")
        if origin not in (None, f"http://{host}"):
            return (403, "Pages of other sites may not use this server.\n")
        scheme, _, bearer = headers.get("authorization", "").partition(" ")
        by_header = scheme.lower() == "bearer" and self._is_token(bearer)
        by_cookie = any(map(self._is_token, _cookies(headers, _name_and_port(host)[1])))
        if not (by_header or by_cookie or self._is_token(given)):
            return (
                403,
                "The token is missing or wrong: open the address that `pcretrieve serve` printed, which "
                "ends in ?token=..., or send the header Authorization: Bearer TOKEN.\n",
            )
        if method not in SAFE_METHODS and origin is None and not by_header:
            return (
                403,
                "A request that changes something needs an Origin, or the token in Authorization.\n",
            )
        return None

    def _is_token(self, given: str | None) -> bool:
        return given is not None and hmac.compare_digest(
            given.encode("utf-8", "replace"), self._token
        )


def _name_and_port(host: str) -> tuple[str | None, int]:
    try:
        parts = urlsplit(f"//{host}")
        return parts.hostname, parts.port or 80
    except ValueError:
        return None, 80


def _cookies(headers: dict[str, str], port: int) -> list[str]:
    """The values of the cookie; several, if another program of this computer has set one of the same name."""
    # Not `SimpleCookie`, which finds nothing if the cookie of any other program is not as it expects.
    pairs = (part.strip().partition("=") for part in headers.get("cookie", "").split(";"))
    return [value for name, _, value in pairs if name == f"{COOKIE}{port}"]


def _with_headers(send: Send, started: float) -> Send:
    """Send answers with the headers of all answers, and with the time since the request was received (ms)."""

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            timing = {
                "server-timing": f"total;dur={(time.perf_counter() - started) * 1e3:.1f}"
            }
            own = [
                (name.encode(), value.encode())
                for name, value in (HEADERS | timing).items()
            ]
            message = {**message, "headers": [*message.get("headers", ()), *own]}
        await send(message)

    return sending


async def _sent(send: Send, status: int, headers: dict[str, str], words: str) -> None:
    body = words.encode()
    both = {**headers, "content-length": str(len(body)), "cache-control": "no-store"}
    raw = [(name.encode(), value.encode("latin-1")) for name, value in both.items()]
    await send({"type": "http.response.start", "status": status, "headers": raw})
    await send({"type": "http.response.body", "body": body})
