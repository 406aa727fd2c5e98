"""What a session shows: sliders and menus, figures and texts."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from functools import partial
from importlib.resources import files
from typing import Any

from bokeh.document import Document
from bokeh.events import ConnectionLost, DocumentReady
from bokeh.models import (
    Button,
    Column,
    ColumnDataSource,
    CustomJS,
    CustomJSTickFormatter,
    InlineStyleSheet,
    Row,
    Select,
    Slider,
)

from fastcoil.deliver.explore import words
from fastcoil.deliver.explore.figures import LETTERS, figures, letters, map_figure
from fastcoil.deliver.explore.loop import AXES, Map, Model, Run
from fastcoil.deliver.explore.settings import (
    CHOICES,
    DIALS,
    STORIES,
    Choice,
    Dial,
    Settings,
    Start,
    Value,
    query_of,
    words_of,
)
from fastcoil.deliver.explore.words import python_lines, study_file

Turn = Callable[[str, Value], None]
SHEET = """
:host, .bk-input, .bk-btn, .bk-slider-title, label { font-size: 1rem; color: #222; }
.bk-slider-title { padding: 0; white-space: nowrap; }
.noUi-handle:focus, .bk-input:focus, .bk-btn:focus { outline: 3px solid #004488; outline-offset: 2px; }
.bk-btn { padding: 6px 10px; }
"""
_SHOWN = "const value = Number(steps[Math.round(tick)] * factor); return Number(value.toPrecision(4)) + ' ' + unit"


class DialControl:
    """A slider over the steps of a dial; a value between them is added as a step."""

    def __init__(self, dial: Dial, turn: Turn) -> None:
        self.dial = dial
        self.steps = list(dial.steps)
        self._format = CustomJSTickFormatter(code=_SHOWN, args=self._args())
        self.widget = Slider(
            title=dial.label, start=0, end=len(self.steps) - 1, step=1, value=0, format=self._format, name=dial.name,
            sizing_mode="stretch_width", stylesheets=[InlineStyleSheet(css=SHEET)], bar_color="#004488",
        )  # fmt: skip
        self._quiet = False
        self.widget.on_change(
            "value", lambda _, __, at: None if self._quiet else turn(dial.name, self.steps[round(at)])
        )

    def _args(self) -> dict[str, Any]:
        return {"steps": self.steps, "factor": self.dial.factor, "unit": self.dial.unit.replace(" of stroke", "")}

    def show(self, value: float) -> None:
        """Move the slider without calling ``turn``."""
        at = bisect_left(self.steps, value)
        self._quiet = True
        if at == len(self.steps) or self.steps[at] != value:
            self.steps.insert(at, value)
            self._format.args = self._args()
            self.widget.end = len(self.steps) - 1
        self.widget.value = at
        self._quiet = False

    def nearest(self, value: float) -> float:
        """The step next to a value."""
        return min(self.steps, key=lambda step: abs(step - value))


class ChoiceControl:
    """A menu of the words of a choice."""

    def __init__(self, choice: Choice, turn: Turn) -> None:
        self.choice = choice
        self.widget = Select(
            title=choice.label, options=[], name=choice.name, sizing_mode="stretch_width",
            stylesheets=[InlineStyleSheet(css=SHEET)],
        )  # fmt: skip
        self._quiet = False
        self.widget.on_change("value", lambda _, __, word: None if self._quiet else turn(choice.name, word))

    def show(self, word: str, words: Mapping[str, str]) -> None:
        """Select one of the allowed words without calling ``turn``."""
        self._quiet = True
        self.widget.options = list(words.items())
        self.widget.value = word
        self._quiet = False


class Controls:
    """All sliders and menus.  turn: called with the name and the new value of what is moved."""

    def __init__(self, starts: Mapping[str, Start], turn: Turn) -> None:
        self._starts = starts
        self.dials = {name: DialControl(dial, turn) for name, dial in DIALS.items()}
        loops = Choice("loop", "Begin with", {name: start.title for name, start in starts.items()})
        self.choices = {name: ChoiceControl(choice, turn) for name, choice in ({"loop": loops} | CHOICES).items()}

    def show(self, settings: Settings) -> None:
        """Stand where the settings stand."""
        start = self._starts[settings.loop]
        for name, dial in self.dials.items():
            dial.show(float(settings.values[name]))
        for name, control in self.choices.items():
            words = control.choice.words if name == "loop" else words_of(control.choice, start)
            control.show(str(settings.values[name]), words)
        self.dials["m_a"].widget.disabled = settings.day in ("own", "steps")


TITLE = "fastcoil: a valve with a gap"
_TEXTS = ("headline", "learning", "prediction", "outcome", "map-note", "problems")
"""Elements of the template that hold a sentence."""
_SHOW = """
const now = texts.data
for (const id of ids) document.getElementById(id).textContent = now[id][0]
document.body.dataset.phase = now.phase[0]
document.body.dataset.turn = now.turn[0]
document.body.dataset.learns = now.learning[0] ? 'yes' : ''
const search = now.query[0] ? '?' + now.query[0] : ''
if (search !== location.search) history.replaceState(null, '', location.pathname + search)
"""
_AT_ONCE = "document.body.dataset.phase = 'loop'"
_COPY = """
const of = {link: () => location.href, python: () => texts.data.python[0]}
navigator.clipboard.writeText(of[what]()).then(
    () => { document.getElementById('said').textContent = said },
    () => { document.getElementById('said').textContent = 'The browser does not let this page copy.' })
"""
_DOWNLOAD = """
const link = document.createElement('a')
link.href = URL.createObjectURL(new Blob([texts.data.toml[0]], {type: 'text/plain'}))
link.download = 'loop.toml'
link.click()
URL.revokeObjectURL(link.href)
document.getElementById('said').textContent = 'Saved as loop.toml: fastcoil run loop.toml'
"""
_LOST = """
document.getElementById('headline').textContent =
    'The program behind this page has ended: start fastcoil explore again.'
document.body.dataset.phase = 'refused'
"""


class Page:
    """The figures, the controls and the texts of one session.

    first_words: the sentence until there is anything to see.  turn: what to do with a new value.  tell: a story, by
    its number.  reset: back to the link.  go: to a cell of the map.
    """

    def __init__(
        self,
        doc: Document,
        model: Model,
        first_words: str,
        turn: Turn,
        tell: Callable[[int], None],
        reset: Callable[[], None],
        go: Callable[[int, int], None],
    ) -> None:
        self._model = model
        self._map: tuple[Map, str] | None = None
        self._turns = 0
        self._texts = ColumnDataSource(
            {name: [""] for name in (*_TEXTS, "phase", "query", "python", "toml", "turn")}, name="texts"
        )
        self.figures, self.map = figures(), map_figure(go)
        self.controls = Controls(model.starts, turn)
        self._put_together(doc, tell, reset)
        doc.template_variables["first_words"] = first_words
        self._say(headline=first_words)

    def waits(self, settings: Settings) -> None:
        """Mark what is shown as outdated."""
        self.controls.show(settings)
        self._say(phase="loop", problems="")

    def show_run(self, settings: Settings, run: Run) -> None:
        """Show a loop."""
        self.figures.show(run, settings.window)
        start = self._model.starts[settings.loop]
        self._say(
            headline=words.headline(run),
            learning=words.learning(run),
            prediction=words.prediction(run),
            outcome=words.outcome(run),
            query=query_of(settings, self._model.starts, self._model.first),
            python=python_lines(settings, start),
            toml=study_file(settings, start),
            phase="map",
        )

    def show_map(self, settings: Settings, found: Map) -> None:
        """Show the map around it: the view is up to date."""
        if self._map is None or self._map[0] is not found or self._map[1] != settings.colour:
            self.map.show(found, settings)
            self._map = found, settings.colour
        on_map = self.map.mark(AXES[settings.axes], settings)
        self._end("" if on_map else "This loop lies outside the map.")

    def refuse_map(self, sentences: list[str]) -> None:
        """Say why there is no map."""
        self.map.clear()
        self._map = None
        self._end(_joined(["No map", *sentences]))

    def _end(self, note: str) -> None:
        """What is shown is what the controls say."""
        self._turns += 1
        self._say(phase="", turn=str(self._turns), **{"map-note": note})

    def refuse(self, headline: str, sentences: list[str]) -> None:
        """Say why there is nothing to see."""
        self._say(headline=headline, problems=_joined(sentences), phase="refused")

    def complain(self, sentences: list[str]) -> None:
        """Say what was wrong with the link."""
        self._say(problems=_joined(sentences))

    def _say(self, **texts: str) -> None:
        self._texts.data = dict(self._texts.data) | {name: [text] for name, text in texts.items()}

    def _put_together(self, doc: Document, tell: Callable[[int], None], reset: Callable[[], None]) -> None:
        show = CustomJS(code=_SHOW, args={"texts": self._texts, "ids": list(_TEXTS)})
        self._texts.js_on_change("data", show)
        at_once = CustomJS(code=_AT_ONCE)
        dials = [dial.widget for dial in self.controls.dials.values()]
        choices = {name: control.widget for name, control in self.controls.choices.items()}
        for widget in (*dials, *choices.values()):
            widget.js_on_change("value", at_once)
        drawn = (*self.figures.all, self.map.fig)
        for figure in drawn:
            doc.add_root(figure)
        abreast = (("valve", "estimator"), ("day", "window"))
        pairs = [Row(*(choices[name] for name in names), sizing_mode="stretch_width") for names in abreast]
        doc.add_root(Column(choices["loop"], *dials, *pairs, name="controls", sizing_mode="stretch_width"))
        doc.add_root(Row(choices["axes"], choices["colour"], name="map-choices", sizing_mode="stretch_width"))
        stories = [_button(story.title, partial(tell, k)) for k, story in enumerate(STORIES)]
        doc.add_root(Row(*stories, name="stories", styles={"flex-wrap": "wrap", "gap": "4px"}))
        taken = [_button("Reset", reset), *self._take_home()]
        doc.add_root(Row(*taken, name="tools", styles={"flex-wrap": "wrap", "gap": "4px"}))
        # a session may have worked before the page is there: what it said then is no change any more
        doc.js_on_event(DocumentReady, CustomJS(code=LETTERS, args={"letters": letters(*drawn)}), show)
        doc.js_on_event(ConnectionLost, CustomJS(code=_LOST))
        doc.title = TITLE
        doc.template = files("fastcoil.deliver.explore").joinpath("page.html").read_text(encoding="utf-8")

    def _take_home(self) -> list[Button]:
        found = {title: _button(title) for title in ("Copy link", "Copy Python", "Save TOML")}
        link = {"texts": self._texts, "what": "link", "said": "The link is copied."}
        found["Copy link"].js_on_click(CustomJS(code=_COPY, args=link))
        python = {"texts": self._texts, "what": "python", "said": "The lines are copied."}
        found["Copy Python"].js_on_click(CustomJS(code=_COPY, args=python))
        found["Save TOML"].js_on_click(CustomJS(code=_DOWNLOAD, args={"texts": self._texts}))
        return [*found.values()]


def _joined(sentences: list[str]) -> str:
    return "  ".join(f"{sentence.rstrip('.')}." for sentence in sentences)


def _button(title: str, act: Callable[[], None] | None = None) -> Button:
    button = Button(label=title, name=title, stylesheets=[InlineStyleSheet(css=SHEET)], width_policy="min", margin=0)
    if act is not None:
        button.on_click(lambda *_: act())
    return button
