"""The loop and its day to take home: lines of Python, or a study file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastcoil.deliver.explore.model.scene import day_of, loop_of
from fastcoil.deliver.explore.model.settings import Settings
from fastcoil.deliver.explore.model.start import GIVEN, Start
from fastcoil.loops.presets import PRESETS
from fastcoil.model.parameter_table import Scalar

_BASE = "paper_like"
"""The preset that a loop which is none is told by."""


def python_lines(settings: Settings, start: Start) -> str:
    """A script that simulates the loop."""
    preset, changed = _told_by(settings, start)
    assign = f".assign({_arguments(changed)})" if changed else ""
    day = day_of(settings, start)
    made = f"fc.{day.maker}({_arguments(day.arguments)})" if day else f"fc.paper_day()  # give that of {start.title}"
    run = "" if day else f", warm_up={start.warm_up}, seed={start.seed}"
    return (
        "import fastcoil as fc\n\n"
        f"loop = fc.Loop.preset({_quoted(preset)}){assign}\n"
        f"day = {made}\n"
        f"ds = fc.simulate(loop, day{run})\n"
        'print(ds[["rmse", "hunts", "hunting_swing", "hunting_period"]])\n'
    )


def study_file(settings: Settings, start: Start) -> str:
    """A study file for ``fastcoil run``."""
    preset, changed = _told_by(settings, start)
    day = day_of(settings, start)
    lines = ["# from `fastcoil explore`", "[loop]", f"preset = {_quoted(preset)}", *_rows(changed), ""]
    if day is None:
        return "\n".join([*lines, f"# [boundary]: that of {start.title}", ""])
    return "\n".join([*lines, "[boundary]", f"kind = {_quoted(day.maker)}", *_rows(day.arguments), ""])


def _told_by(settings: Settings, start: Start) -> tuple[str, dict[str, Scalar]]:
    """A preset, and what differs from it."""
    preset = _BASE if settings.loop == GIVEN else settings.loop
    constants = loop_of(settings, start).constants
    changed = {name: constants[name] for name in PRESETS[preset].changed(constants)}
    if changed.get("estimator") == "none" and "estimator" not in PRESETS[preset].values:
        del changed["estimator"]
    return preset, changed


def _rows(values: Mapping[str, Any]) -> list[str]:
    return [f"{name} = {_literal(value)}" for name, value in values.items()]


def _arguments(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={_literal(value)}" for name, value in values.items())


def _literal(value: object) -> str:
    return _quoted(value) if isinstance(value, str) else repr(value)


def _quoted(text: str) -> str:
    return f'"{text}"'
