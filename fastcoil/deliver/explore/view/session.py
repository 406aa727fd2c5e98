"""One session: a reader moves things, the page follows, and says so while it does not."""

from __future__ import annotations

import asyncio
from concurrent.futures import Executor
from functools import partial

from bokeh.document import Document, without_document_lock

from fastcoil.base.errors import InputError
from fastcoil.deliver.explore.model.map import AXES, Map
from fastcoil.deliver.explore.model.model import Model
from fastcoil.deliver.explore.model.settings import Settings, Value, read_query, settings_of
from fastcoil.deliver.explore.model.stories import STORIES, told
from fastcoil.deliver.explore.view.page import Page

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
        self.move(told(STORIES[number], self._model.starts))

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
