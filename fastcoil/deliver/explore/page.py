"""The page of one reader, with its work on other threads; the server, for this machine only."""

import asyncio
import logging
import re
import secrets
import signal
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from importlib.resources import files
from typing import Any

from bokeh.document import Document, without_document_lock
from bokeh.events import ConnectionLost, DocumentReady
from bokeh.models import Button, CategoricalSlider, Column, ColumnDataSource, CustomJS, InlineStyleSheet, Row, Select
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.settings import settings
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop
from tornado.routing import Matcher, Rule, RuleRouter

from fastcoil.base.arrays import Array
from fastcoil.base.errors import InputError
from fastcoil.deliver.explore import loop
from fastcoil.deliver.explore.figures import Change, LoopFigures, MapFigure
from fastcoil.deliver.explore.loop import DIALS, MAP_AXES, MENUS, STORIES, ExplanationText, Model, Run, Settings
from fastcoil.model.engine.lanes import compile_kernel

_STYLE_SHEET = """
:host, .bk-input, .bk-btn, .bk-slider-title, label { font-size: 1rem; color: #222; }
.bk-slider-title { padding: 0; white-space: nowrap; }
.noUi-handle:focus, .bk-input:focus, .bk-btn:focus { outline: 3px solid #004488; outline-offset: 2px; }
.bk-btn { padding: 6px 10px; }
"""
_TEXT_IDS = ("headline", "compared", "learning", "why", "advice", "note", "problems", "error")
"""Ids of the elements of the page that hold a sentence."""
_SHOW_CHANGES_SCRIPT = """
const [changes, texts] = sent.tags
for (const [id, values] of changes) sent.document.get_model_by_id(id).setv(values, {sync: false})
for (const id of ids) document.getElementById(id).textContent = texts[id]
for (const word of ['phase', 'explained', 'turn']) document.body.dataset[word] = texts[word]
document.body.dataset.learns = texts.learning ? 'yes' : ''
"""
_CONTROL_MOVED_SCRIPT = "document.body.dataset.phase = 'loop'"
_CONNECTION_LOST_SCRIPT = """
document.getElementById('headline').textContent =
    'The program behind this page has ended: start fastcoil explore again.'
document.body.dataset.phase = 'refused'
"""


class Page:
    """The page that one reader sees.

    ``simulate_pool`` simulates the loop, ``explain_pool`` explains it and makes its map, so that the page always
    responds.  A move cancels the explanation and the map of the previous one.
    """

    def __init__(
        self, doc: Document, model: Model, simulate_pool: Executor, explain_pool: Executor, first_words: str
    ) -> None:
        self._doc, self._model, self._simulate_pool, self._explain_pool = doc, model, simulate_pool, explain_pool
        self._on_next_tick = doc.add_next_tick_callback
        self._settings = self._initial_settings = loop.initial_settings(model.first, model.starts[model.first])
        self._is_working, self._turns = False, 0
        self._pending_stage: asyncio.Future[Any] | None = None  # explanation or map
        self._explained_settings: Settings | None = None  # None while the loop in the figures is not explained
        self._texts = dict.fromkeys((*_TEXT_IDS, "phase", "explained", "turn"), "")
        self._outbox = ColumnDataSource(name="sent")  # its tags take changes and texts to the browser
        self._figures, self._map = LoopFigures(), MapFigure(self._move_to_cell)
        style: Any = {"sizing_mode": "stretch_width", "stylesheets": [InlineStyleSheet(css=_STYLE_SHEET)]}
        self._steps: dict[str, dict[str, float]] = {name: {} for name in DIALS}
        empty = {"categories": ["", "…"], "value": "", **style}
        self._dials = {n: CategoricalSlider(title=dial.label, name=n, **empty) for n, dial in DIALS.items()}
        labels = {"loop": "Begin with"} | {name: choice.label for name, choice in MENUS.items()}
        self._menus = {name: Select(title=label, name=name, **style) for name, label in labels.items()}
        for name, slider in self._dials.items():
            slider.on_change("value", partial(self._on_dial_moved, name))
        for name, menu in self._menus.items():
            menu.on_change("value", partial(self._on_menu_chosen, name))
        self._build_layout(first_words)
        self._show_waiting()
        self._send(headline=first_words, explained="yes")
        # a request alone computes nothing, only a page in a browser does
        doc.on_event(DocumentReady, lambda _: self._change_settings(self._settings))

    # --- moves --------------------------------------------------------------------------------------------------------

    def _on_dial_moved(self, name: str, _attribute: str, _old: str, text: str) -> None:
        value: Any = self._steps[name][text]
        if value != getattr(self._settings, name):
            self._change_settings(replace(self._settings, **{name: value}))

    def _on_menu_chosen(self, name: str, _attribute: str, _old: str, word: str) -> None:
        settings, changes = self._settings, {name: word}
        if word != getattr(settings, name):
            if name == "loop":
                changes = {"axes": settings.axes, "colour": settings.colour, "window": settings.window}
                settings = loop.initial_settings(word, self._model.starts[word])
            self._change_settings(replace(settings, **changes))  # type: ignore[arg-type]

    def _move_to_cell(self, x: float, y: float) -> None:
        """Change the settings to those of a clicked cell of the map, at the nearest steps of its dials."""
        changes: Any = {}
        for coordinate, (name, values) in zip((x, y), MAP_AXES[self._settings.axes].items(), strict=True):
            value = values[min(max(round(coordinate), 0), len(values) - 1)]
            changes[name] = min(self._steps[name].values(), key=lambda step: abs(step - value))  # noqa: B023
        self._change_settings(replace(self._settings, **changes))

    def _change_settings(self, settings: Settings) -> None:
        """Change the settings, and show the loop that they describe as soon as it is computed."""
        self._settings = settings
        self._show_waiting()
        if self._pending_stage is not None:
            self._pending_stage.cancel()
        if not self._is_working:
            self._is_working = True
            self._on_next_tick(self._compute_until_settled)

    def _show_waiting(self) -> None:
        """Set all controls to the settings, and mark the results shown as outdated."""
        start = self._model.starts[self._settings.loop]
        for name, slider in self._dials.items():
            value = getattr(self._settings, name)
            steps = {DIALS[name].value_text(step): step for step in sorted({*DIALS[name].steps, value})}
            self._steps[name] = steps | {DIALS[name].value_text(value): value}
            slider.update(categories=list(steps), value=DIALS[name].value_text(value))
        self._dials["m_a"].disabled = self._settings.day in ("own", "steps")
        for name, menu in self._menus.items():
            titles = {n: s.title for n, s in self._model.starts.items()}
            texts = loop.menu_words(name, start) if name in MENUS else titles
            menu.update(options=list(texts.items()), value=getattr(self._settings, name))
        self._send(phase="loop", problems="")

    # --- work ---------------------------------------------------------------------------------------------------------

    @without_document_lock  # type: ignore[untyped-decorator]
    async def _compute_until_settled(self) -> None:
        """Compute and show until the settings no longer change."""
        target = None
        try:
            while target != self._settings:
                target = self._settings
                try:
                    await self._compute_stages(target)
                except asyncio.CancelledError:  # moved on
                    pass
                except InputError as error:
                    self._show_refusal("This loop cannot be simulated.", error.problems)
        except Exception:
            self._show_refusal("fastcoil failed here: the terminal says where.", [])
            raise
        finally:
            self._is_working = False

    async def _compute_stages(self, settings: Settings) -> None:
        """Simulate a loop, then explain it and make its map; show each result when it is ready."""
        run = await asyncio.get_running_loop().run_in_executor(self._simulate_pool, self._model.run, settings)
        if self._explained_settings != loop.loop_settings(settings):
            self._explained_settings = None
        self._on_next_tick(partial(self._show_run, settings, run, is_explained=self._explained_settings is not None))
        if self._explained_settings is None:
            explanation = await self._run_stage(settings, self._model.explain)
            self._explained_settings = loop.loop_settings(settings)
            self._on_next_tick(partial(self._show_explanation, settings, run, explanation))
        try:
            metrics = await self._run_stage(settings, self._model.map)
        except InputError as error:  # a map may be refused although the loop is not
            metrics = error
        self._on_next_tick(partial(self._show_map, settings, metrics))

    async def _run_stage(self, settings: Settings, compute: Callable[[Settings], Any]) -> Any:
        """Compute the explanation or the map on another thread; cancelled if the settings changed."""
        if settings != self._settings:
            raise asyncio.CancelledError
        self._pending_stage = asyncio.get_running_loop().run_in_executor(self._explain_pool, compute, settings)
        return await self._pending_stage

    def _show_run(self, settings: Settings, run: Run, *, is_explained: bool) -> None:
        changes = self._figures.show(run, settings.window)
        changes += [] if is_explained else self._figures.show_hunting_index()
        texts = {"error": run.error_text, "learning": run.learning_text, "explained": "yes" if is_explained else ""}
        self._send(changes, settings, phase="words", **texts)

    def _show_explanation(self, settings: Settings, run: Run, e: ExplanationText) -> None:
        texts = {"headline": e.answer, "why": e.why, "compared": run.reading_text or e.compared, "advice": e.advice}
        self._send(self._figures.show_hunting_index(e.hunting_index), settings, explained="yes", phase="map", **texts)

    def _show_map(self, settings: Settings, metrics: Mapping[str, Array] | InputError) -> None:
        if isinstance(metrics, InputError):
            changes, note = self._map.clear(), _join_sentences(["No map", *metrics.problems])
        else:
            changes, is_on_map = self._map.show(metrics, settings)
            note = "" if is_on_map else "This loop lies outside the map."
        self._turns += 1
        self._send(changes, settings, note=note, turn=str(self._turns), phase="")

    def _show_refusal(self, headline: str, sentences: Sequence[str]) -> None:
        self._explained_settings, empty_texts = None, dict.fromkeys(("compared", "learning", "why", "advice"), "")
        texts = {"headline": headline, "problems": _join_sentences(sentences), "explained": "yes", "phase": "refused"}
        self._on_next_tick(partial(self._send, **texts, **empty_texts))

    def _send(self, changes: Sequence[Change] = (), of: Settings | None = None, /, **texts: str) -> None:
        """Send changes of figures and texts to the browser in one message; of: their settings, perhaps outdated."""
        self._texts |= texts if of in (None, self._settings) else texts | {"phase": "loop"}
        self._outbox.tags = [list(changes), dict(self._texts)]

    # --- layout -------------------------------------------------------------------------------------------------------

    def _build_layout(self, first_words: str) -> None:
        doc = self._doc
        show_changes = CustomJS(code=_SHOW_CHANGES_SCRIPT, args={"sent": self._outbox, "ids": list(_TEXT_IDS)})
        self._outbox.js_on_change("tags", show_changes)
        for widget in (*self._dials.values(), *self._menus.values()):
            # a document holds the models of its widgets, through these also the outbox
            widget.js_on_change("value", CustomJS(code=_CONTROL_MOVED_SCRIPT, args={"sent": self._outbox}))
        for fig in (*self._figures.all, self._map.fig):
            doc.add_root(fig)
        menus, wide = self._menus, {"sizing_mode": "stretch_width"}
        menu_rows = [Row(menus[a], menus[b], **wide) for a, b in (("valve", "estimator"), ("day", "test"))]
        controls = (menus["loop"], *self._dials.values(), *menu_rows, menus["window"])
        doc.add_root(Column(*controls, name="controls", **wide))
        doc.add_root(Row(menus["axes"], menus["colour"], name="map-choices", **wide))
        story_settings = {name: loop.story_settings(name, self._model.starts) for name in STORIES}
        story_buttons = [_make_button(name, partial(self._change_settings, s)) for name, s in story_settings.items()]
        reset_button = _make_button("Reset", partial(self._change_settings, self._initial_settings))
        for name, buttons in (("stories", story_buttons), ("tools", [reset_button])):
            doc.add_root(Row(*buttons, name=name, styles={"flex-wrap": "wrap", "gap": "4px"}))
        # texts that were sent before the page was ready cause no change any more
        doc.js_on_event(DocumentReady, show_changes)
        doc.js_on_event(ConnectionLost, CustomJS(code=_CONNECTION_LOST_SCRIPT))
        doc.title = "fastcoil: a valve with a gap"
        doc.template = files("fastcoil.deliver.explore").joinpath("page.html").read_text(encoding="utf-8")
        doc.template_variables["first_words"] = first_words


def _join_sentences(sentences: Sequence[str]) -> str:
    return "  ".join(f"{sentence.rstrip('.')}." for sentence in sentences)


def _make_button(title: str, act: Callable[[], None]) -> Button:
    sheets = [InlineStyleSheet(css=_STYLE_SHEET)]
    button = Button(label=title, name=title, stylesheets=sheets, width_policy="min", margin=0)
    button.on_click(lambda *_: act())
    return button


_SERVER_ADDRESS = "127.0.0.1"  # not reachable from the network
_HOST_NAMES = ("localhost", _SERVER_ADDRESS)
_STATIC_PATH = re.compile(r"/static(/[A-Za-z0-9_][A-Za-z0-9_.-]*)+")  # nothing to decode or resolve
_IDLE_LIFETIME_MS = 10_000  # of a page without a connection; then its 2 MB are released


class _LocalOnlyMatcher(Matcher):  # type: ignore[misc]
    """Accepts requests of a reader or of the page itself; anything else is not found.

    Host: a foreign page whose name resolves to this machine (DNS rebinding) sends its own name.  Origin: browsers name
    the page that opens a socket.  Sec-Fetch-Dest: a foreign page that embeds this one gets nothing.  Sessions are named
    by the server alone, or a link would lead into another reader's page.
    """

    def __init__(self, port: int) -> None:
        self._hosts = {f"{name}:{port}" for name in _HOST_NAMES}
        self._origins = {f"http://{host}" for host in self._hosts}

    def match(self, request: HTTPServerRequest) -> dict[str, Any] | None:
        headers, path = request.headers, request.path
        origin, destination = headers.get("Origin"), headers.get("Sec-Fetch-Dest", "document")
        is_ours = request.host in self._hosts and (origin is None or origin in self._origins)
        names_session = any(name.startswith("bokeh-") for name in request.arguments) or "Bokeh-Session-Id" in headers
        is_page, is_socket = path == "/" and destination == "document", path == "/ws" and origin is not None
        is_known = is_page or is_socket or _STATIC_PATH.fullmatch(path) is not None
        return {} if is_ours and is_known and not names_session else None


async def serve(model: Model, port: int, on_ready: Callable[[str], None]) -> None:
    """Serve the page on ``port``, 0: any free one, until SIGINT or SIGTERM; ``on_ready`` gets its address."""
    try:
        listener = socket.create_server((_SERVER_ADDRESS, port), backlog=128)
    except OSError as error:
        problem = f"port {port} cannot be used ({error.strerror})"
        cure = f"give another one above 1023, such as --port {max(port, 5009) + 1}"
        raise InputError(f"{problem}: {cure}", "--port", "conflict") from None
    listener.setblocking(False)
    port = listener.getsockname()[1]
    # foreign connections and closed pages are no errors
    for name in ("tornado.access", "tornado.application", "tornado.general", "bokeh"):
        logging.getLogger(name).setLevel(logging.ERROR)
    # no environment variable opens the page to others, or loads it from elsewhere
    settings.resources = "server"
    settings.allowed_ws_origin = [f"{name}:{port}" for name in _HOST_NAMES]
    simulate_pool, explain_pool = ThreadPoolExecutor(2), ThreadPoolExecutor(2)

    def make_page(doc: Document) -> None:
        Page(doc, model, simulate_pool, explain_pool, "Starting: about 12 s where nothing is compiled yet …")

    app = BokehTornado(
        {"/": make_page}, extra_websocket_origins=settings.allowed_ws_origin(), secret_key=secrets.token_bytes(32),
        sign_sessions=True, unused_session_lifetime_milliseconds=_IDLE_LIFETIME_MS,
        check_unused_sessions_milliseconds=_IDLE_LIFETIME_MS,
        websocket_max_message_size_bytes=2**16, session_token_expiration=60,  # a message of a slider has a few hundred
    )  # fmt: skip
    http = HTTPServer(RuleRouter([Rule(_LocalOnlyMatcher(port), app)]))
    server = BaseServer(IOLoop.current(), app, http)
    server.start()
    http.add_socket(listener)
    threading.Thread(target=compile_kernel, daemon=True).start()
    end_event = asyncio.Event()
    wake = asyncio.get_running_loop().call_soon_threadsafe
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: wake(end_event.set))
    on_ready(f"http://{_HOST_NAMES[0]}:{port}/")
    await end_event.wait()
    # cancelled work is no error
    logging.getLogger("tornado.application").setLevel(logging.CRITICAL)
    server.stop()
    for pool in (simulate_pool, explain_pool):
        pool.shutdown(wait=False, cancel_futures=True)
