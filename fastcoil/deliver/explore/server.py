"""The server: one page, for this machine alone, and a session for each reader."""

import asyncio
import logging
import secrets
import signal
import socket
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.routing import Matcher, Rule, RuleRouter

from fastcoil.base.errors import InputError
from fastcoil.deliver.explore.loop import Model
from fastcoil.deliver.explore.page import Page
from fastcoil.model.engine.lanes import compile_kernel
from fastcoil.model.numerics.jit import is_compiled

ADDRESS = "127.0.0.1"
"""Not reachable from the network."""
_NAMES = ("localhost", ADDRESS)
_THREADS = 2
COMPILING = "Compiling the simulator, once: about 20 s.  The page then begins by itself."
STARTING = "Starting …"
_IDLE = 10_000  # ms without a connection, after which a page and its 2 MB are given back
_LONGEST_MESSAGE = 2**16  # bytes; what a slider says has a few hundred


class _FromHere(Matcher):  # type: ignore[misc]
    """Lets through what a reader or the page itself asks for; anything else is not found.

    Host: a foreign page whose name leads here (DNS rebinding) gives its own.  Origin: browsers name the page that opens
    a socket or fetches, so a socket without one is refused.  Sec-Fetch-Dest: a foreign page that shows this one, or
    takes it for an image or a script, gets nothing.  Names of sessions and tokens are made here, never taken from an
    address, or a link would lead into the page of another.
    """

    def __init__(self, port: int) -> None:
        self._hosts = {f"{name}:{port}" for name in _NAMES}
        self._origins = {f"http://{host}" for host in self._hosts}

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        headers, path = request.headers, request.path
        origin, taken_for = headers.get("Origin"), headers.get("Sec-Fetch-Dest", "document")
        is_ours = request.host in self._hosts and (origin is None or origin in self._origins)
        names_session = any(name.startswith("bokeh-") for name in request.arguments) or "Bokeh-Session-Id" in headers
        is_known = (
            (path == "/" and taken_for == "document")
            or (path == "/ws" and origin is not None)
            or path.startswith("/static/")
        )
        return {} if is_ours and is_known and not names_session else None


async def serve(model: Model, port: int, ready: Callable[[str], None]) -> None:
    """Serve the page until SIGINT or SIGTERM.

    Parameters
    ----------
    model
        Shared by all sessions.
    port
        0 takes any that is free.
    ready
        Called with the address of the page once it can be opened.
    """
    listening = _bound(port)
    port = listening.getsockname()[1]
    # foreign connections, and readers who leave, are no errors
    for name in ("tornado.access", "tornado.application", "bokeh"):
        logging.getLogger(name).setLevel(logging.ERROR)
    # no environment variable opens the page to others, or has it loaded from elsewhere
    settings.resources = "server"
    settings.allowed_ws_origin = [f"{name}:{port}" for name in _NAMES]
    pool = ThreadPoolExecutor(_THREADS)

    def begin(doc: Document) -> None:
        Page(doc, model, pool, STARTING if is_compiled("emulate") else COMPILING)

    app = BokehTornado(
        {"/": begin}, extra_websocket_origins=settings.allowed_ws_origin(), secret_key=secrets.token_bytes(32),
        sign_sessions=True, unused_session_lifetime_milliseconds=_IDLE, check_unused_sessions_milliseconds=_IDLE,
        websocket_max_message_size_bytes=_LONGEST_MESSAGE, session_token_expiration=60,
    )  # fmt: skip
    http = HTTPServer(RuleRouter([Rule(_FromHere(port), app)]))
    server = BaseServer(IOLoop.current(), app, http)
    server.start()
    http.add_socket(listening)
    threading.Thread(target=compile_kernel, daemon=True).start()
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, ended.set)
    ready(f"http://{_NAMES[0]}:{port}/")
    await ended.wait()
    # what is under way is given up, which is no mistake
    logging.getLogger("tornado.application").setLevel(logging.CRITICAL)
    server.stop()
    pool.shutdown(wait=False, cancel_futures=True)


def _bound(port: int) -> socket.socket:
    try:
        found = socket.create_server((ADDRESS, port), backlog=128)
    except OSError as error:
        problem = f"port {port} cannot be used ({error.strerror})"
        raise InputError(f"{problem}: give another one above 1023, such as --port {max(port, 5009) + 1}") from None
    found.setblocking(False)
    return found
