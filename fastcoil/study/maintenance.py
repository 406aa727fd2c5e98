"""Look at a study's folder: its progress, whether it is sound, one scenario in full or by its labels."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import collect_problems, raise_problems
from fastcoil.base.errors import InputError, Problem, did_you_mean
from fastcoil.base.files import is_file, is_folder, portable_file_name
from fastcoil.base.machine import command_line
from fastcoil.base.text import parse_number_or_word
from fastcoil.loops.boundary import Boundary
from fastcoil.loops.clashes import unread_values
from fastcoil.loops.loop import Loop
from fastcoil.loops.netcdf import save
from fastcoil.loops.plan import JobSlice, Plan, Shard, plan_simulation
from fastcoil.loops.presets import PRESETS
from fastcoil.loops.scenarios import Layout, clock_coordinates, coordinate_attrs
from fastcoil.loops.simulate import run_shard
from fastcoil.model.engine.lanes import TraceRequest, compile_kernel
from fastcoil.model.metric_table import METRICS, STATUS_CRASHED, STATUS_MEANINGS, STATUS_NOT_RUN, STATUS_OK, TRACES
from fastcoil.model.numerics.jit import model_sha256, numeric_environment
from fastcoil.model.parameter_table import PARAMETERS
from fastcoil.model.user_rules import hash_user_code
from fastcoil.study.analysis.precision import read_precision
from fastcoil.study.analysis.selected import list_first, select_labels
from fastcoil.study.file.spec import build_boundary, read_study
from fastcoil.study.file.user_code import Prepare, UserCode, load_code, load_function
from fastcoil.study.folder.folder import StudyFolder, find_holder, find_running_slices, hold_folder
from fastcoil.study.folder.results import find_folder_problems, open_metrics
from fastcoil.study.folder.state import is_result_of
from fastcoil.study.folder.stored import Manifest, study_attributes

RERUNS_FOLDER = "reruns"


def status(folder: Path) -> list[str]:
    """Describe the progress of the study in a folder, in lines of text."""
    store, holder, slices = StudyFolder(folder), find_holder(folder), find_running_slices(folder)
    running = [f"It is being run by {holder}."] if holder else []
    held = [name.replace("-of-", "/") for name, slice_holder in slices.items() if slice_holder]
    if held:
        running.append(f"Shares that are being run: {list_first(held)}.")
    try:
        manifest, ds = store.require_manifest(), open_metrics(folder, {*TRACES, *METRICS})
        ds = open_metrics(folder) if read_precision(ds) else ds
    except InputError:  # no shard is finished
        if not running and Manifest.read(folder) is None:
            raise
        return ["Nothing is finished yet.", *running]
    counts = {word: int((ds["status"].values == k).sum()) for k, word in enumerate(STATUS_MEANINGS)}
    n, n_left, precision = ds["status"].size, counts["not_run"], read_precision(ds)
    unfinished = n_left or "content_sha256" not in ds.attrs or (precision is not None and not precision.is_enough(ds))
    words = ", ".join(f"{count:,} {word}" for word, count in counts.items() if count)
    lines = [
        str(ds.attrs["title"]),
        f"{'Unfinished' if unfinished else 'Finished'}: {n - n_left:,} of {n:,} scenarios ({words})",
        *([precision.describe_result(ds)] if precision else []),
    ]
    if manifest.model_sha256 != model_sha256():
        lines.append("The sources of the model have changed since: a new run computes everything again.")
    if slices and n_left:
        plan, missing = store.read_study(manifest).plan, ds["status"].values.ravel() == STATUS_NOT_RUN
        for n in sorted({int(name.partition("-of-")[2]) for name in slices}):
            due = [f"{k}/{n}" for k in range(1, n + 1) if missing[JobSlice(k, n).index(plan)].any()]
            due = [name for name in due if name not in held]
            running.append(f"Of {n} shares {len(due)} are to be run{': ' * bool(due)}{list_first(due)}.")
    resume = f"To resume: {command_line(['fastcoil', 'run', store.find_source(), '-o', str(folder)])}"
    return [*lines, *running, *([resume] if unfinished else [])]


def verify(folder: Path) -> list[str]:
    """Check everything in the folder of a study: a sentence for each problem.  Nothing is changed."""
    store = StudyFolder(folder)
    return store.read_consistently(lambda: find_folder_problems(store))


def rerun(folder: Path, at: Mapping[str, str], prepare: Prepare = load_function) -> tuple[Path, list[str]]:
    """Run one scenario of a study again, with all traces at every second; return the file, and the outcome in lines.

    at: dimension → label, for every dimension with more than one.  prepare: loads user-defined rules; a reduction is
    not run.  ``IntegrityError`` if the study, or a file it reads, changed since it was run.
    """
    store = StudyFolder(folder)
    manifest = store.require_manifest()
    study = store.read_study(manifest)
    layout = study.plan.layout
    coordinates = layout.coordinates()
    flat, position, labels = _locate_scenario(layout, at)
    plan = replace(study.plan, traces=TraceRequest(tuple(TRACES), 1))
    path = folder / RERUNS_FOLDER / f"{portable_file_name('_'.join(labels) or 'scenario')}.nc"
    # not the study, which may be running; a folder that cannot be written is refused now
    with hold_folder(path.parent):
        pass
    load_code(layout.loop.rules, study.rules, prepare)
    if manifest.model_sha256 == model_sha256():
        hash_user_code(layout.loop.rules.values(), manifest.user_code)  # refuses another rule
    compile_kernel()
    shard = Shard(np.array([flat]))
    if plan.carry_over:  # the days before are run first, without traces
        day, lane = divmod(flat, plan.n_per_day)
        shard = Shard(np.array([lane]), plan.n_per_day, day, day + 1)
    ds = run_shard(plan, shard).squeeze("scenario", drop=True)
    for dim, coordinate in coordinates.items():
        label = coordinate.isel({d: position[str(d)] for d in coordinate.dims}).reset_coords(drop=True)
        ds = ds.assign_coords({dim: label.assign_attrs(coordinate_attrs(dim, layout.loop.parameters))})
    boundary = layout.boundary if "day" not in position else layout.boundary.isel(position["day"])
    ds = ds.assign_coords(clock_coordinates(boundary, ds.variables["elapsed_time"]))
    here = replace(manifest, computed_on=[numeric_environment()])
    ds.attrs = study_attributes(replace(study, plan=plan, reduction=None), here)
    with hold_folder(path.parent):
        save(ds, path)
    return path, _compare_with_stored(store, ds, position)


def _locate_scenario(layout: Layout, at: Mapping[str, str]) -> tuple[int, dict[str, int], list[str]]:
    """Find a scenario by its labels ``at``: flat index, position along each dimension, and DIM=LABEL of each."""
    sizes = layout.sizes
    flat = np.arange(math.prod(sizes.values())).reshape(tuple(sizes.values()))
    ds = xr.Dataset({"status": (tuple(sizes), flat)}, layout.coordinates())
    selection = select_labels(ds, {dim: [text] for dim, text in at.items()})
    labels = {str(dim): list_first(selection[dim].values) for dim, n in selection["status"].sizes.items() if n > 1}
    missing = [f"--at: {dim} is missing, choose one of {known}" for dim, known in labels.items()]
    raise_problems([Problem(sentence, "--at", "missing") for sentence in missing])
    selection = selection.squeeze()
    index = int(selection["status"])
    position = dict(zip(sizes, map(int, np.unravel_index(index, flat.shape)), strict=True))
    return index, position, [f"{dim}={selection[dim].values}" for dim in sizes]


def _compare_with_stored(store: StudyFolder, ds: xr.Dataset, position: Mapping[str, int]) -> list[str]:
    """State whether a rerun gave the result that the study has."""
    rmse, code = float(ds["rmse"]), int(ds["status"])
    error = "no rmse, the loop was off" if np.isnan(rmse) and code == STATUS_OK else f"rmse {rmse:.4g} K"
    lines = [f"{error}, status {STATUS_MEANINGS[code]}"]
    try:
        results = open_metrics(store.path)
    except InputError:
        return lines
    stored = results.isel(position)
    if int(stored["status"]) in (STATUS_NOT_RUN, STATUS_CRASHED):
        return [*lines, f"In the study its status is {STATUS_MEANINGS[int(stored['status'])]}."]
    names = [n for n in (*METRICS, "status") if n in stored]  # an older version wrote fewer
    different = [n for n in names if not np.array_equal(ds[n].values, stored[n].values, equal_nan=True)]
    if not different:
        return [*lines, "Equal to the study's result to the last bit."]
    reason = "" if is_result_of(results, store.require_manifest()) else "; the model changed since"
    return [*lines, f"Differs from the study's result in {', '.join(different)}{reason}."]


class Scenario(NamedTuple):
    """A single loop on a single day; title: where it comes from, and its labels."""

    title: str
    loop: Loop
    boundary: Boundary
    warm_up: int
    seed: int


def pick_scenario(
    target: Path, at: Mapping[str, str], changes: Mapping[str, str], prepare: Prepare = load_function
) -> Scenario:
    """Pick one scenario of a preset, a study or its results.

    target: a preset, on the day that suits it; a study file; or the folder of a study.
    at: dimension → label, for every dimension with more than one.  changes: parameter → value, as text, for the whole
    study, so that a dimension whose only parameter is changed needs no label.  Only rules of the scenario are prepared.
    """
    title, plan, sources = _load_target(target)
    loop, boundary = plan.layout.loop, plan.layout.boundary
    problems: list[str] = []
    with collect_problems(problems, "--set "):
        loop = loop.assign(**{name: parse_number_or_word(text) for name, text in changes.items()})
    if "replicate" in at:
        sentence = "--at replicate: replicates differ by their noise alone, leave it out"
        problems.append(Problem(sentence, "--at", "conflict"))
    layout = Layout(loop, boundary)
    position: dict[str, int] = {}
    with collect_problems(problems):
        _, position, labels = _locate_scenario(layout, {dim: label for dim, label in at.items() if dim != "replicate"})
    raise_problems(problems)
    swept = layout.loop.swept
    loop = loop.assign(**{n: v.isel({d: position[str(d)] for d in v.dims}).item() for n, v in swept.items()})
    unread = [name for name in unread_values(loop) if name not in changes] if layout.loop.sizes else []
    defaults: dict[str, Any] = {name: PARAMETERS[name].default for name in unread}
    loop = loop.assign(**defaults)
    load_code(Layout(loop, boundary).loop.rules, sources, prepare)
    day_note = "this day alone, from rest" if plan.carry_over and position.get("day") else ""
    changes_text = ", ".join(f"{name}={text}" for name, text in changes.items())
    full_title = "; ".join(filter(None, [title, ", ".join(labels), changes_text, day_note]))
    return Scenario(full_title, loop, boundary.isel(day=position.get("day", 0)), plan.warm_up, plan.seed)


def _load_target(target: Path) -> tuple[str, Plan, Mapping[str, UserCode]]:
    """Return title, plan and sources of user-defined rules of the study or preset."""
    name = str(target)
    if name in PRESETS:
        preset = PRESETS[name]
        options: dict[str, Any] = {"warm_up": 4 * 3600} if preset.has_room else {}  # rooms settle in hours
        plan = plan_simulation(Loop.preset(name), build_boundary(preset.day, Path()), **options)
        return f"{name} on {preset.day_text}", plan, {}
    if is_folder(target):
        store = StudyFolder(target)
        study = store.read_study(store.require_manifest())
    elif is_file(target):
        study = read_study(target)
    else:
        sentence = f"{target}: no such file, folder or preset{did_you_mean(name, PRESETS)}"
        cure = f"give a study file, the folder of its results, or one of {', '.join(PRESETS)}"
        raise InputError(f"{sentence}; {cure}", name, "path")
    return study.title, study.plan, study.rules
