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
from fastcoil.deliver.explore.loop import ExplanationText, loop_settings, start_loops
from fastcoil.deliver.explore.page import Page

REFUSED_GAP = 0.15
MOVES = (("backlash", (0.05, 0.1, REFUSED_GAP)), ("test", ("none", "usual")), ("window", ("2h", "day")))


class DeferredExecutor(Executor):
    """Does a piece of work when requested."""

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


class FakeDocument(Document):
    """A document that keeps what it is to do next."""

    def add_next_tick_callback(self, callback):
        self.__dict__.setdefault("soon", []).append(callback)

    def tick(self):
        outcome = self.soon.pop(0)()
        if asyncio.iscoroutine(outcome):
            self.__dict__.setdefault("tasks", []).append(asyncio.ensure_future(outcome))


class FakeModel:
    """A model that says of a loop which one it is."""

    starts, first = start_loops(), "paper_like"

    def run(self, settings):
        if settings.backlash == REFUSED_GAP:
            raise InputError("refused")
        return SimpleNamespace(of=settings, error_text="", learning_text="", reading_text="")

    def explain(self, settings):
        return ExplanationText(str(loop_settings(settings)), "", "", "", settings.backlash)

    def map(self, settings):
        return settings


class FakeFigures:
    """In place of the figures, and of the map: changes that name the loop they are of."""

    all, fig = (), None

    def show(self, content, _):
        is_run = hasattr(content, "of")
        return [("traces", {"of": content.of})] if is_run else ([("map", {"of": content})], True)

    def show_hunting_index(self, *hunting_index):
        return [("hunting_index", {"of": hunting_index})]


def open_page():
    """A page, its document, and who simulates and explains for it."""
    first, then, doc = DeferredExecutor(), DeferredExecutor(), FakeDocument()
    page = Page(doc, FakeModel(), first, then, "Starting")
    page._figures = page._map = FakeFigures()
    return page, doc, first, then


async def play_random_moves(seed):
    """Move, work and show at random; each message with all that the browser then shows."""
    rng, messages = np.random.default_rng(seed), []
    page, doc, first, then = open_page()
    visible = {"traces": None, "hunting_index": ()}

    def receive(_attribute, _old, new):
        changes, texts = new
        visible.update({name: values["of"] for name, values in changes})
        messages.append(visible | texts | {"asked": page._settings})

    page._outbox.on_change("tags", receive)
    page._change_settings(page._settings)
    for moves_left in range(150, -60, -1):
        possible_steps = [pool.work for pool in (first, then) if pool.waiting] + [doc.tick] * bool(doc.soon)
        if moves_left > 0 and rng.random() < 0.25:
            name, values = MOVES[rng.integers(len(MOVES))]
            page._change_settings(replace(page._settings, **{name: values[rng.integers(len(values))]}))
        elif possible_steps:
            possible_steps[rng.integers(len(possible_steps))]()
        for _ in range(5 if moves_left <= 0 else rng.integers(4)):
            await asyncio.sleep(0)
    assert not first.waiting + then.waiting + doc.soon
    for task in doc.tasks:
        task.result()
    return page._settings, messages


@pytest.mark.parametrize("seed", range(8))
def test_words_and_margin_are_those_of_the_loop_that_is_drawn_and_come_in_the_end(seed):
    settings, messages = asyncio.run(play_random_moves(seed))
    for message in messages:
        is_refused = message["headline"] == "This loop cannot be simulated."
        if message["explained"] and message["traces"] is not None and not is_refused:
            assert message["headline"] == str(loop_settings(message["traces"]))
            assert message["hunting_index"] == (message["traces"].backlash,)
        elif not message["explained"]:
            assert message["hunting_index"] == ()
        assert is_refused or message["phase"] == "loop" or message["traces"] == message["asked"]
    if settings.backlash == REFUSED_GAP:
        assert (messages[-1]["phase"], messages[-1]["advice"]) == ("refused", "")
    else:
        assert (messages[-1]["phase"], messages[-1]["traces"], messages[-1]["map"]) == ("", settings, settings)
        assert messages[-1]["explained"] == "yes"
    assert any(not message["explained"] for message in messages)
    assert any(message["phase"] == "loop" and message["explained"] for message in messages)


def test_a_move_does_not_wait_for_the_explanation_of_the_loop_before():
    async def play():
        page, doc, first, then = open_page()

        async def draw():
            while not first.waiting:
                doc.tick()
                await asyncio.sleep(0)
            (piece,) = first.waiting
            first.work()
            for _ in range(5):
                await asyncio.sleep(0)
            return piece[2][0].backlash

        page._change_settings(page._settings)
        assert await draw() == page._settings.backlash
        (explanation,) = then.waiting
        page._change_settings(replace(page._settings, backlash=0.1))
        await asyncio.sleep(0)
        assert explanation[0].cancelled()
        assert await draw() == 0.1
        assert len(then.waiting) == 2

    asyncio.run(play())
