"""The controller's laws as plain Python: the templates in ``laws/``, filled in for one loop."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from textwrap import wrap

import jinja2

from fastcoil.base.machine import package_version
from fastcoil.deliver.export.settings import Settings
from fastcoil.loops.labels import unit_in_words
from fastcoil.model.parameter_table import PARAMETERS

LAWS = Path(__file__).parent / "laws"
WIDTH = 100
"""Characters of a line of code."""
_COMPOUND = {"K-1 s-1": "1/(K s)"}
"""Units that figures leave as they are."""


@cache
def templates() -> jinja2.Environment:
    """The templates; a line that begins with ``#:`` is for them alone."""
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(LAWS),
        line_statement_prefix="#:",
        trim_blocks=True,
        keep_trailing_newline=True,
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # noqa: S701 — no page
    )


def laws_of(settings: Settings) -> str:
    """The laws of a controller in Python, without what it does not need."""

    def parameter(name: str) -> str:
        return _constant(name, settings.number[name])

    child = settings.estimator if settings.has_estimate else "controller"
    text = (
        templates()
        .get_template(f"{child}.py.jinja")
        .render(settings.parts(), parameter=parameter, version=package_version(), words=words_of(settings))
    )
    text = re.sub(r"\n+(?=(def|class) )", "\n\n\n", text)
    return re.sub(r"\n+(?=# (Parameters|Fixed)|import )", "\n\n", text)


def words_of(settings: Settings) -> str:
    """What a controller consists of."""
    number = settings.number
    parts = ["a PI law"]
    if number["error_dead_band"] > 0.0:
        parts.append("a dead band")
    if settings.compensation == "additive":
        parts.append("half the backlash added to its output")
    elif settings.compensation == "smooth":
        parts.append("a smooth backlash inverse")
    elif settings.has_estimate or number["backlash_estimate"] > 0.0:
        parts.append("a backlash inverse")
    if settings.has_estimate:
        parts.append(f"the estimator {settings.estimator}")
    last = f" and {parts.pop()}" if len(parts) > 1 else ""
    return f"{', '.join(parts)}{last}"


def _constant(name: str, value: float) -> str:
    """A parameter as a constant, with its unit and meaning."""
    unit = PARAMETERS[name].unit
    unit = _COMPOUND.get(unit) or unit_in_words(unit)
    meaning = f"{unit}: {PARAMETERS[name].text}" if unit else PARAMETERS[name].text
    line = f"{name.upper()} = {number(value)}"
    if max(len(line), 33) + len(meaning) < WIDTH - 18:
        return f"{line}  # {meaning}"
    return "\n".join([*(f"# {part}" for part in wrap(meaning, WIDTH - 12)), line])


def number(value: float) -> str:
    """A number with all its digits: 1e-9, not 1e-09."""
    return re.sub(r"e([-+])0", r"e\1", repr(float(value)))
