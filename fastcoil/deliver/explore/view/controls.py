"""Sliders and choices, which stand where the settings stand."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping
from typing import Any

from bokeh.models import CustomJSTickFormatter, InlineStyleSheet, Select, Slider

from fastcoil.deliver.explore.model.settings import CHOICES, DIALS, Choice, Dial, Settings, Value, words_of
from fastcoil.deliver.explore.model.start import Start

Turn = Callable[[str, Value], None]
SHEET = """
:host, .bk-input, .bk-btn, .bk-slider-title, label { font-size: 1rem; color: #222; }
.bk-slider-title { padding: 0; white-space: nowrap; }
.noUi-handle:focus, .bk-input:focus, .bk-btn:focus { outline: 3px solid #004488; outline-offset: 2px; }
.bk-btn { padding: 6px 10px; }
"""
_SHOWN = "const value = Number(steps[Math.round(tick)] * factor); return Number(value.toPrecision(4)) + ' ' + unit"


class DialControl:
    """A slider over the steps of a dial; a value between them becomes a step of its own."""

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
        """Move the slider without telling anybody."""
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
        """Select a word of those that are allowed, without telling anybody."""
        self._quiet = True
        self.widget.options = list(words.items())
        self.widget.value = word
        self._quiet = False


class Controls:
    """All sliders and menus.  turn: called with the name and the new value of what somebody moves."""

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
