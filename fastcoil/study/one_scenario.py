"""One scenario of a study, picked by its labels, without running anything that comes with the study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from fastcoil.base.errors import InputError, collecting, nearest
from fastcoil.base.files import is_file, is_folder
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.boundary.days import heating_day, paper_day
from fastcoil.loops.clashes import unread_values
from fastcoil.loops.loop import Loop
from fastcoil.loops.presets import PRESETS
from fastcoil.loops.scenarios import Layout
from fastcoil.model.metric_table import WARM_UP
from fastcoil.model.parameter_table import PARAMETERS, check_name
from fastcoil.study.file.spec import read_study
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.maintenance import find_position


class Scenario(NamedTuple):
    """A single loop on a single day.

    title: where it comes from, and its labels.  warm_up, seed: of the study.
    """

    title: str
    loop: Loop
    boundary: Boundary
    warm_up: int
    seed: int


def one_scenario(target: Path, at: Mapping[str, str], changes: Mapping[str, str]) -> Scenario:
    """Pick one scenario.

    Parameters
    ----------
    target
        The name of a preset, on ``paper_day()`` or, if it heats, on ``heating_day()``; the folder of a study; or a
        study file, run or not.
    at
        Dimension → label, exactly as the study has it, for every dimension with more than one.
    changes
        Parameter → value, as text; they hold for the whole study, so that a dimension whose only parameter is changed
        needs no label.

    Raises
    ------
    InputError
        With one sentence for each mistake; where the scenario uses code that comes with the study.
    IntegrityError
        If the study in a folder, or a file it reads, changed since it was run.
    """
    title, loop, boundary, warm_up, seed, carry_over = _whole(target)
    problems: list[str] = []
    with collecting(problems, "--set "):
        loop = loop.assign(**_values(loop, changes))
    layout = Layout(loop, boundary)
    coordinates = layout.coordinates()
    labels = {dim: coordinates[dim].values for dim in layout.sizes}
    if "replicate" in at:
        problems.append("--at replicate: replicates differ by their noise alone, leave it out")
    position: dict[str, int] = {}
    with collecting(problems):
        position = find_position(labels, {dim: label for dim, label in at.items() if dim != "replicate"})
    if problems:
        raise InputError(problems)
    one = layout.loop.assign(**_at(layout.loop, position)) if layout.loop.sizes else layout.loop
    others = [name for name in unread_values(one) if name not in changes] if layout.loop.sizes else []
    one = one.assign(**{name: PARAMETERS[name].default for name in others})
    rules = Layout(one, boundary).loop.rules
    foreign = [word for word, rule in rules.items() if not rule.is_loaded]
    if foreign:
        raise InputError(
            f"{target}: the scenario uses {' and '.join(foreign)}, code of the study's own, which is not run here: "
            "pick another scenario with --at, or use fc.explain in Python"
        )
    place = ", ".join(f"{dim}={labels[dim][k]}" for dim, k in position.items())
    apart = "this day by itself, from rest" if carry_over and position.get("day") else ""
    changed = ", ".join(f"{name}={text}" for name, text in changes.items())
    named = "; ".join(filter(None, [title, place, changed, apart]))
    return Scenario(named, one, boundary.isel(day=position.get("day", 0)), warm_up, seed)


def _whole(target: Path) -> tuple[str, Loop, Boundary, int, int, bool]:
    """Title, loop, boundary, warm-up and seed of all that a target holds; whether its days are a sequence."""
    name = str(target)
    if name in PRESETS:
        preset = PRESETS[name]
        day = heating_day(T_w_in=preset.T_w_in) if preset.heats else paper_day()
        words = f"heating_day(T_w_in={preset.T_w_in:g})" if preset.heats else "paper_day()"
        return f"{name} on {words}", Loop.preset(name), day, WARM_UP, 0, False
    if is_folder(target):
        store = StudyFolder(target)
        study = store.read_study(store.require_manifest())
    elif is_file(target):
        study = read_study(target)
    else:
        raise InputError(
            f"{target}: no such file, folder or preset{nearest(name, PRESETS)}; give a study file, the folder of its "
            f"results, or one of {', '.join(PRESETS)}"
        )
    plan = study.plan
    return study.title, plan.layout.loop, plan.layout.boundary, plan.warm_up, plan.seed, plan.carry_over


def _values(loop: Loop, changes: Mapping[str, str]) -> dict[str, float | str]:
    """The changes as numbers and words."""
    values: dict[str, float | str] = {}
    problems: list[str] = []
    for name, text in changes.items():
        with collecting(problems):
            is_word = loop.parameters[check_name(name, loop.parameters)].is_word
            values[name] = text if is_word else _number(name, text)
    if problems:
        raise InputError(problems)
    return values


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{name}={text}: give a number") from None


def _at(loop: Loop, position: Mapping[str, int]) -> dict[str, float | str]:
    """The swept parameters at one position."""
    return {name: values.isel({d: position[str(d)] for d in values.dims}).item() for name, values in loop.swept.items()}
