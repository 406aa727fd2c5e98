"""What a folder has of a study: results, finished shards, what an earlier and smaller version left."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.errors import InputError, IntegrityError
from fastcoil.outputs import STATUS_NOT_RUN, TRACES
from fastcoil.study.file.spec import Study, read_study
from fastcoil.study.folder.extend import as_part, reusable
from fastcoil.study.folder.merge import opened, partial, trace_problems
from fastcoil.study.folder.store import RESULTS, STUDY, Begun, begun, begun_text, committed


def open_study(folder: str | Path) -> xr.Dataset:
    """Open the results of a study by its folder, checked against their hash.

    Of a study that is not finished yet, what there is: the other scenarios have the status ``not_run``.  Traces of a
    finished one stay on the disk until they are asked for.
    """
    folder = Path(folder)
    run = begun(folder)
    if run is None:
        raise InputError(f"{folder} holds no study: run one first, with `fastcoil run STUDY.toml -o {folder}`")
    if (folder / RESULTS).exists():
        ds = opened(folder)
        if is_current(ds, run):
            return ds
    study = begun_study(folder, run)
    earlier = Earlier.of(folder, study, run)
    parts = earlier.parts(committed(folder, run.key, mend=False), study.kept_traces)
    ds = partial(study.plan, parts, attributes(study, run.model_sha256))
    if not ds.data_vars:
        raise InputError(f"{folder} has no finished scenario yet: wait, or run the study")
    return ds


def begun_study(folder: Path, run: Begun) -> Study:
    """The study whose results lie in a folder, from the text there.

    Raises
    ------
    IntegrityError
        If a file it reads is not what it was.
    """
    if begun_text(folder) is None:
        raise IntegrityError(f"{folder / STUDY} is missing or damaged: bring it back, or run the study again")
    try:
        study = read_study(folder / STUDY, Path(run.relative_to))
    except InputError as error:
        raise IntegrityError(f"{folder}: what was begun cannot be read any more: bring it back\n{error}") from None
    if study.sha256 != run.study_sha256:
        what = (
            "the series of its [boundary]"
            if study.plan.layout.boundary.sha256 != run.boundary_sha256
            else f"{STUDY}, a file that it includes, or its reduction"
        )
        raise IntegrityError(f"{folder}: {what} changed since the run was begun: bring it back, or run it elsewhere")
    return study


def is_current(ds: xr.Dataset, run: Begun) -> bool:
    """Whether a result is that of the run, complete and of the same model."""
    same = (ds.attrs.get("study_sha256"), ds.attrs.get("model_sha256")) == (run.study_sha256, run.model_sha256)
    return same and not bool((ds["status"] == STATUS_NOT_RUN).any())


@dataclass(frozen=True)
class Earlier:
    """What a folder has of a smaller version of the study: its results, and where they are in both."""

    n_scenarios: int
    results: xr.Dataset | None = None
    old: np.ndarray | None = None
    new: np.ndarray | None = None
    n_volumes: int = 0

    @classmethod
    def of(cls, folder: Path, study: Study, run: Begun) -> Earlier:
        """Find it; nothing where there are no results, or only those of another model."""
        n = study.plan.n_scenarios
        if not (folder / RESULTS).exists():
            return cls(n)
        results = opened(folder)
        if results.attrs.get("model_sha256") != run.model_sha256:
            return cls(n)
        old, new = reusable(study.plan, attributes(study, run.model_sha256), results)
        # what is damaged must not be written again with a hash of its own
        problems = trace_problems(folder, results)
        if problems:
            cure = f"delete {folder / RESULTS} and run the study again"
            raise IntegrityError("\n".join(f"{problem}: {cure}" for problem in problems))
        return cls(n, results, old, new, study.plan.n_volumes)

    def parts(self, shards: Iterable[xr.Dataset], traces: Collection[str]) -> Iterator[xr.Dataset]:
        """All parts of the study: what was there before, with these traces only, and the shards.

        Each scenario once: after a merge that was killed before it removed the shards, it is in both.
        """
        parts = shards
        if self.results is not None and self.old is not None and self.new is not None and self.new.size:
            names = [n for n in self.results.data_vars if n not in TRACES or n in traces]
            parts = chain([as_part(self.results[names], self.old, self.new, self.n_volumes)], shards)
        seen = np.zeros(self.n_scenarios, dtype=bool)
        for part in parts:
            index = part["scenario"].values
            yield part.isel(scenario=~seen[index]) if seen[index].any() else part
            seen[index] = True


def attributes(study: Study, model: str) -> dict[str, Any]:
    """The attributes that say which study a result is of."""
    attrs = {
        "title": study.title,
        "summary": study.question,
        "study_toml": study.text,
        "study_sha256": study.sha256,
        "model_sha256": model,
    }
    traces = study.plan.traces
    if traces.names:
        attrs["traces"] = f"{', '.join(traces.names)} every {traces.interval} s"
    if study.reduction:
        attrs |= {"reduction": study.reduction.name, "reduction_sha256": study.reduction.sha256}
    return attrs
