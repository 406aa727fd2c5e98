"""The page says of a loop only what was found of the one that it draws, whatever is moved while threads work."""

import asyncio
from concurrent.futures import Executor, Future
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("bokeh")
from bokeh.document import Document

from fastcoil.base.errors import InputError
from fastcoil.deliver.explore.loop import Words, of_loop, starts
from fastcoil.deliver.explore.page import Page

REFUSED_GAP = 0.15
MOVES = (("backlash", (0.05, 0.1, REFUSED_GAP)), ("test", ("none", "usual")), ("window", ("2h", "day")))


class Later(Executor):
    """Does a piece of work when told to."""

    def __init__(self):
        self.waiting = []

    def submit(self, call, *arguments):
        future = Future()
        self.waiting.append((future, call, arguments))
        return future

    def work(self):
        future, call, arguments = self.waiting.pop(0)
        if future.set_running_or_notify_cancel():
            try:
                future.set_result(call(*arguments))
            except InputError as error:
                future.set_exception(error)


class Shown(Document):
    """A document that keeps what it is to do next."""

    session_context = SimpleNamespace(request=SimpleNamespace(arguments={}))

    def add_next_tick_callback(self, callback):
        self.__dict__.setdefault("soon", []).append(callback)

    def tick(self):
        found = self.soon.pop(0)()
        if asyncio.iscoroutine(found):
            self.__dict__.setdefault("tasks", []).append(asyncio.ensure_future(found))


class Loops:
    """A model that says of a loop which one it is."""

    starts, first = starts(), "paper_like"

    def run(self, settings):
        if settings.backlash == REFUSED_GAP:
            raise InputError("refused")
        return SimpleNamespace(of=settings, error="", learning="", reading="")

    def explain(self, settings):
        return Words(str(of_loop(settings)), "", "", "", settings.backlash)

    def map(self, settings):
        return settings


class Drawn:
    """In place of the figures, and of the map: changes that name the loop they are of."""

    all, fig = (), None

    def show(self, found, _):
        is_run = hasattr(found, "of")
        return [("traces", {"of": found.of})] if is_run else ([("map", {"of": found})], True)

    def show_margin(self, *margin):
        return [("margin", {"of": margin})]


def opened():
    """A page, its document, and who simulates and explains for it."""
    first, then, doc = Later(), Later(), Shown()
    page = Page(doc, Loops(), first, then, "Starting")
    page._figures = page._map = Drawn()
    return page, doc, first, then


async def moved(seed):
    """Move, work and show at random; each message with all that the browser then shows."""
    rng, seen = np.random.default_rng(seed), []
    page, doc, first, then = opened()
    shown = {"traces": None, "margin": ()}

    def receive(_attribute, _old, new):
        changes, said = new
        shown.update({name: values["of"] for name, values in changes})
        seen.append(shown | said | {"asked": page._settings})

    page._sent.on_change("tags", receive)
    page._move(page._settings)
    for left in range(150, -60, -1):
        ways = [pool.work for pool in (first, then) if pool.waiting] + [doc.tick] * bool(doc.soon)
        if left > 0 and rng.random() < 0.25:
            name, values = MOVES[rng.integers(len(MOVES))]
            page._move(replace(page._settings, **{name: values[rng.integers(len(values))]}))
        elif ways:
            ways[rng.integers(len(ways))]()
        for _ in range(5 if left <= 0 else rng.integers(4)):
            await asyncio.sleep(0)
    assert not first.waiting + then.waiting + doc.soon
    for task in doc.tasks:
        task.result()
    return page._settings, seen


@pytest.mark.parametrize("seed", range(8))
def test_words_and_margin_are_those_of_the_loop_that_is_drawn_and_come_in_the_end(seed):
    settings, seen = asyncio.run(moved(seed))
    for now in seen:
        is_refused = now["headline"] == "This loop cannot be simulated."
        if now["told"] and now["traces"] is not None and not is_refused:
            assert now["headline"] == str(of_loop(now["traces"]))
            assert now["margin"] == (now["traces"].backlash,)
        elif not now["told"]:
            assert now["margin"] == ()
        assert is_refused or now["phase"] == "loop" or now["traces"] == now["asked"]
    if settings.backlash == REFUSED_GAP:
        assert (seen[-1]["phase"], seen[-1]["advice"]) == ("refused", "")
    else:
        assert (seen[-1]["phase"], seen[-1]["traces"], seen[-1]["map"]) == ("", settings, settings)
        assert seen[-1]["told"] == "yes"
    assert any(not now["told"] for now in seen)
    assert any(now["phase"] == "loop" and now["told"] for now in seen)


def test_a_move_does_not_wait_for_the_explanation_of_the_loop_before():
    async def play():
        page, doc, first, then = opened()

        async def draw():
            while not first.waiting:
                doc.tick()
                await asyncio.sleep(0)
            (piece,) = first.waiting
            first.work()
            for _ in range(5):
                await asyncio.sleep(0)
            return piece[2][0].backlash

        page._move(page._settings)
        assert await draw() == page._settings.backlash
        (explanation,) = then.waiting
        page._move(replace(page._settings, backlash=0.1))
        await asyncio.sleep(0)
        assert explanation[0].cancelled()
        assert await draw() == 0.1
        assert len(then.waiting) == 2

    asyncio.run(play())
