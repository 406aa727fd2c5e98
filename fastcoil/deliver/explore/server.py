"""The server: one page, for this machine alone, and a session for each reader."""

from __future__ import annotations

import asyncio
import errno
import logging
import signal
import socket
import threading
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from typing import Any

from bokeh.document import Document, without_document_lock
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.routing import Matcher, Rule, RuleRouter

from fastcoil.base.errors import InputError, StorageError
from fastcoil.deliver.explore.loop import AXES, Map, Model
from fastcoil.deliver.explore.page import Page
from fastcoil.deliver.explore.settings import STORIES, Settings, Value, read_query, settings_of, settings_of_story
from fastcoil.model.numerics.jit import is_compiled

REFUSED = "This loop cannot be simulated."
BROKEN = "fastcoil failed here: the terminal says where."


class Session:
    """Settings of one reader, and the page that shows them.

    The work is done on other threads, so that the server hears every move; of several moves during one piece of work
    only the last counts.
    """

    def __init__(self, doc: Document, model: Model, pool: Executor, first_words: str) -> None:
        self._doc, self._model, self._pool = doc, model, pool
        request = doc.session_context.request
        query = {name: values[-1].decode(errors="replace") for name, values in request.arguments.items()}
        self._settings, problems = read_query(query, model.starts, model.first)
        self._begin = self._settings
        self._working = False
        self._page = Page(doc, model, first_words, self.turn, self._tell, lambda: self.move(self._begin), self._go)
        self._problems = [*problems, "The rest of the link is shown."] if problems else []
        self.move(self._settings)

    def turn(self, name: str, value: Value) -> None:
        """Move to one new value."""
        settings = self._settings
        if name == "loop":
            kept = {one: settings.values[one] for one in ("axes", "colour", "window")}
            self.move(settings_of(str(value), self._model.starts[str(value)]).turned(**kept))
        else:
            self.move(settings.turned(**{name: value}))

    def move(self, settings: Settings) -> None:
        """Show other settings, as soon as they are computed."""
        self._settings = settings
        self._page.waits(settings)
        if not self._working:
            self._working = True
            self._doc.add_next_tick_callback(self._work)

    def _tell(self, number: int) -> None:
        self.move(settings_of_story(STORIES[number], self._model.starts))

    def _go(self, i: int, j: int) -> None:
        """To a cell of the map."""
        x, y = AXES[self._settings.axes]
        if 0 <= i < len(x.values) and 0 <= j < len(y.values):
            dials = self._page.controls.dials
            self.move(
                self._settings.turned(
                    **{axis.name: dials[axis.name].nearest(axis.values[k]) for axis, k in ((x, i), (y, j))}
                )
            )

    @without_document_lock  # type: ignore[untyped-decorator]
    async def _work(self) -> None:
        """Compute and show until nothing has moved any more."""
        shown = None
        try:
            while shown != self._settings:
                settings = self._settings
                await self._follow(settings)
                shown = settings
        except Exception:
            self._soon(partial(self._page.refuse, BROKEN, []))
            raise
        finally:
            self._working = False

    async def _follow(self, settings: Settings) -> None:
        """Compute a loop and its map, side by side, and show each as soon as it is there."""
        loop = asyncio.get_running_loop()
        ahead = loop.run_in_executor(self._pool, _sweep, self._model, settings)
        try:
            run = await loop.run_in_executor(self._pool, self._model.run, settings)
            self._soon(partial(self._page.show_run, settings, run))
        except InputError as error:
            await ahead
            self._soon(partial(self._page.refuse, REFUSED, error.problems))
            return
        self._soon(partial(self._show_map, settings, await ahead))

    def _show_map(self, settings: Settings, found: Map | InputError) -> None:
        if isinstance(found, InputError):
            self._page.refuse_map(found.problems)
        else:
            self._page.show_map(settings, found)
        if self._problems:
            self._page.complain(self._problems)
            self._problems = []
        if settings != self._settings:
            self._page.waits(self._settings)

    def _soon(self, show: partial[None]) -> None:
        self._doc.add_next_tick_callback(partial(self._at_once, show))

    def _at_once(self, show: partial[None]) -> None:
        """In one message: the browser draws each figure once."""
        self._doc.hold("combine")
        show()
        self._doc.unhold()


def _sweep(model: Model, settings: Settings) -> Map | InputError:
    """The map, or why there is none: the loop itself may do."""
    try:
        return model.map(settings)
    except InputError as error:
        return error


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
        Session(doc, model, pool, STARTING if is_compiled("emulate") else COMPILING)

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
        if error.errno == errno.EADDRINUSE:
            raise InputError(f"port {port} is taken: give another one, such as --port {port + 1}") from None
        if error.errno == errno.EACCES:
            raise InputError(f"port {port} is not yours to use: give one above 1023, such as --port 5010") from None
        raise StorageError(f"port {port}: {error.strerror}") from None
    found.setblocking(False)
    return found
