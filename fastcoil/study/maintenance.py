"""Looking after a study's folder: how far it is, whether it is sound, one scenario in full."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from fastcoil.engine.host import Traces, compile_kernel
from fastcoil.errors import FastcoilError, InputError, IntegrityError, nearest
from fastcoil.files import reported
from fastcoil.numerics.jit import model_sha256
from fastcoil.outputs import METRICS, STATUS_CRASHED, STATUS_MEANINGS, STATUS_NOT_RUN, TRACES
from fastcoil.simulation.dataset import coordinate_attrs, provenance, save
from fastcoil.simulation.plan import simulation_attributes
from fastcoil.simulation.simulate import run_shard
from fastcoil.study.folder.merge import opened, trace_problems
from fastcoil.study.folder.results import begun_study, is_current, open_study
from fastcoil.study.folder.store import RESULTS, Begun, begun, in_use, inspected

RERUNS = "reruns"


def status(folder: Path) -> list[str]:
    """How far the study in a folder is, in words."""
    run = _begun(folder)
    try:
        ds = open_study(folder)
    except InputError:  # begun, and no shard finished
        return ["Nothing is finished yet."] + _who(folder)
    found = {word: int((ds["status"] == k).sum()) for k, word in enumerate(STATUS_MEANINGS)}
    n, left = ds["status"].size, found["not_run"]
    words = ", ".join(f"{count:,} {word}" for word, count in found.items() if count)
    lines = [
        str(ds.attrs["title"]),
        f"{'Unfinished' if left else 'Finished'}: {n - left:,} of {n:,} scenarios ({words})",
    ]
    if run.model_sha256 != model_sha256():
        lines.append("The sources of the model changed since: a new run computes everything again.")
    return lines + _who(folder) + ([] if left == 0 else [f"To go on: fastcoil run STUDY.toml -o {folder}"])


def verify(folder: Path) -> list[str]:
    """What is wrong in the folder of a study, a sentence each; reads all of it and changes nothing."""
    problems = []
    run = _begun(folder)
    try:
        begun_study(folder, run)
    except (InputError, IntegrityError) as error:
        problems += [f"{line}" for line in str(error).splitlines()]
    if (folder / RESULTS).exists():
        try:
            problems += trace_problems(folder, opened(folder))
        except FastcoilError as error:
            problems.append(str(error))
    return problems + [f"{path} {part}" for path, part in inspected(folder, run.key) if isinstance(part, str)]


def rerun(folder: Path, at: Mapping[str, str]) -> tuple[Path, list[str]]:
    """Run one scenario of a study again, with all traces at every second.

    at: dimension → label, for every dimension with more than one.

    Returns
    -------
    tuple
        The file written, and what was found, in words.

    Raises
    ------
    InputError
        For a dimension or label that the study does not have.
    IntegrityError
        If what the study reads is not what it was.
    """
    run = _begun(folder)
    study = begun_study(folder, run)
    layout = study.plan.layout
    coordinates = layout.coordinates()
    labels = {dim: coordinates[dim].values for dim in layout.sizes}
    place = _place(labels, at)
    flat = int(np.ravel_multi_index(tuple(place.values()), tuple(layout.sizes.values()))) if place else 0
    plan = replace(study.plan, traces=Traces(tuple(TRACES), 1))
    compile_kernel()
    ds = run_shard(plan, np.array([flat])).squeeze("scenario", drop=True)
    for name, coordinate in coordinates.items():
        one = coordinate.isel({d: place[str(d)] for d in coordinate.dims}).reset_coords(drop=True)
        ds = ds.assign_coords({name: one.assign_attrs(coordinate_attrs(name))})
    ds.attrs = {"title": study.title, "summary": study.question, **provenance(), **simulation_attributes(plan)}
    name = "_".join(f"{dim}={labels[dim][k]}" for dim, k in place.items()) or "scenario"
    path = folder / RERUNS / (re.sub(r"[^\w.=+-]", "-", name) + ".nc")
    with reported(path.parent, "made"):
        path.parent.mkdir(exist_ok=True)
    save(ds, path)
    return path, _against_stored(folder, ds, place)


def _begun(folder: Path) -> Begun:
    run = begun(folder)
    if run is None:
        raise InputError(f"{folder} holds no study: run one first, with `fastcoil run STUDY.toml -o {folder}`")
    return run


def _who(folder: Path) -> list[str]:
    holder = in_use(folder)
    return [f"It is being run by {holder}."] if holder else []


def _place(labels: Mapping[str, np.ndarray], at: Mapping[str, str]) -> dict[str, int]:
    """Position along each dimension."""
    problems = [f"--at {dim}: no dimension of the study{nearest(dim, labels)}" for dim in at if dim not in labels]
    place = {}
    for dim, values in labels.items():
        shown = ", ".join(map(str, values[:10])) + (", …" if values.size > 10 else "")
        if dim not in at and values.size == 1:
            place[dim] = 0
        elif dim not in at:
            problems.append(f"--at: {dim} is missing, choose one of {shown}")
        else:
            found = [k for k, v in enumerate(values) if _is(v, at[dim])]
            place[dim] = found[0] if found else 0
            if not found:
                problems.append(f"--at {dim}={at[dim]}: choose one of {shown}")
    if problems:
        raise InputError(problems)
    return place


def _is(label: object, text: str) -> bool:
    if isinstance(label, str):
        return label == text
    try:
        return bool(np.isclose(float(label), float(text), rtol=1e-9, atol=0.0))  # type: ignore[arg-type]
    except ValueError:
        return False


def _against_stored(folder: Path, ds: xr.Dataset, place: Mapping[str, int]) -> list[str]:
    """Whether a rerun found what the study had found."""
    words = [f"rmse {float(ds['rmse']):.4g} K, status {STATUS_MEANINGS[int(ds['status'])]}"]
    try:
        stored = open_study(folder).isel(place)
    except InputError:
        return words
    if int(stored["status"]) in (STATUS_NOT_RUN, STATUS_CRASHED):
        return [*words, f"The study has it as {STATUS_MEANINGS[int(stored['status'])]}."]
    differ = [n for n in (*METRICS, "status") if not np.array_equal(ds[n].values, stored[n].values, equal_nan=True)]
    if not differ:
        return [*words, "Equal to the study's result to the last bit."]
    why = "" if is_current(opened(folder), _begun(folder)) else "; the model changed since"
    return [*words, f"Differs from the study's result in {', '.join(differ)}{why}."]
