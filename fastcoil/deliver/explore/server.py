"""The server: one page, for this machine alone, and a session for each reader."""

from __future__ import annotations

import asyncio
import logging
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
from fastcoil.model.numerics.jit import is_compiled

ADDRESS = "127.0.0.1"
"""Not reachable from the network."""
_NAMES = ("localhost", ADDRESS)
_THREADS = 2
COMPILING = "Compiling the simulator, once: about 20 s.  The page then begins by itself."
STARTING = "Starting …"


class _FromHere(Matcher):  # type: ignore[misc]
    """Lets requests of the page itself pass; anything else is not found.

    Neither a foreign page whose name leads here (DNS rebinding: the Host is theirs), nor one that opens a
    socket to here (the Origin is theirs), gets an answer.
    """

    def __init__(self, port: int) -> None:
        self._hosts = {f"{name}:{port}" for name in _NAMES}
        self._origins = {f"http://{host}" for host in self._hosts}

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        origin = request.headers.get("Origin")
        return {} if request.host in self._hosts and (origin is None or origin in self._origins) else None


def serve(model: Model, port: int, ready: Callable[[str], None]) -> None:
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
    asyncio.run(_serve(model, port, ready))


async def _serve(model: Model, port: int, ready: Callable[[str], None]) -> None:
    listening = _bound(port)
    port = listening.getsockname()[1]
    # foreign connections, and readers who leave, are no errors
    for name in ("tornado.access", "bokeh"):
        logging.getLogger(name).setLevel(logging.ERROR)
    # no environment variable opens the page to others, or has it loaded from elsewhere
    settings.resources = "server"
    settings.allowed_ws_origin = [f"{name}:{port}" for name in _NAMES]
    pool = ThreadPoolExecutor(_THREADS)

    def begin(doc: Document) -> None:
        Page(doc, model, pool, STARTING if is_compiled("emulate") else COMPILING)

    app = BokehTornado({"/": begin}, extra_websocket_origins=settings.allowed_ws_origin())
    http = HTTPServer(RuleRouter([Rule(_FromHere(port), app)]))
    server = BaseServer(IOLoop.current(), app, http)
    server.start()
    http.add_socket(listening)
    threading.Thread(target=model.prepare, daemon=True).start()
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
