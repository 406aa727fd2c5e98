"""What has been computed of a study: results of an earlier version, finished shards, and both as one Dataset."""

from __future__ import annotations

import json
import shlex
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from fastcoil.base.arguments import path_of
from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.loops.dataset import join_flat, unflatten
from fastcoil.loops.provenance import environments_of
from fastcoil.loops.shards import END_STATE, Reached
from fastcoil.model.metric_table import FORMER_METRICS, METRICS, PREDICTIONS, STATUS_NOT_RUN, TRACES
from fastcoil.model.numerics.jit import same_model
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.extend import Match, as_part, match_scenarios
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.manifest import Manifest
from fastcoil.study.folder.merge import study_attributes
from fastcoil.study.folder.result_files import find_problems
from fastcoil.study.folder.shards import Shards


def open_study(folder: str | Path) -> xr.Dataset:
    """Open the results of a study by its folder, checked against their hash.

    An unfinished study can be opened too: scenarios that are not finished yet have the status ``not_run``.  Traces of
    a finished one stay on the disk until they are asked for.  Metrics of an earlier version have their names of today.

    Parameters
    ----------
    folder
        What ``fastcoil run`` wrote, such as ``results/robustness``.

    Returns
    -------
    xarray.Dataset
        Metrics and ``status`` over the dims of the study, and its traces.

    Raises
    ------
    InputError
        If the folder holds no study, or no scenario is finished yet.
    StorageError, IntegrityError
        If it cannot be read; if a file in it is damaged.
    """
    store = StudyFolder(path_of("folder", folder, "give the folder of a study"))
    ds = store.settled(lambda: _open(store))
    return ds.rename({name: today for name, (today, _) in FORMER_METRICS.items() if name in ds and today not in ds})


def open_finished(folder: Path) -> xr.Dataset:
    """Open the results of a finished study.

    Raises
    ------
    InputError
        If the folder holds none, or scenarios are missing.
    StorageError, IntegrityError
        As ``open_study``.
    """
    ds = open_study(folder)
    missing = int((ds["status"].values == STATUS_NOT_RUN).sum())
    if missing or "content_sha256" not in ds.attrs:
        done = ds["status"].size - missing
        command = f"fastcoil run STUDY.toml -o {shlex.quote(str(folder))}"
        raise InputError(
            f"{folder} is unfinished: {done:,} of {ds['status'].size:,} scenarios are done; finish it with `{command}`"
        )
    return ds


def _open(store: StudyFolder) -> xr.Dataset:
    manifest = store.require_manifest()
    if store.has_results:
        ds = store.open_results()
        # with no shard, all that is known of an unfinished study is there
        if is_current(ds, manifest) or (is_of(ds, manifest) and not store.shards(manifest).any()):
            return ds
    elif manifest.finished:
        raise IntegrityError(f"{store.results} is missing: run the study again")
    elif not store.shards(manifest).any():
        raise InputError(f"{store.path} has no finished scenario yet: wait, or run the study")
    study = store.read_study(manifest)
    computed = Computed.find(store, study, manifest)
    parts = computed.parts(quarantine=False)
    ds = unflatten(join_flat(study.plan.n_scenarios, parts), study.plan.layout)
    if not ds.data_vars:
        raise InputError(f"{store.path} has no finished scenario yet: wait, or run the study")
    ds.attrs = study_attributes(study, manifest) | {"computed_on": json.dumps(list(manifest.computed_on))}
    return ds


def is_current(ds: xr.Dataset, manifest: Manifest) -> bool:
    """Whether a result is that of the run, complete and of the same model."""
    return is_of(ds, manifest) and not bool((ds["status"].values == STATUS_NOT_RUN).any())


def is_of(ds: xr.Dataset, manifest: Manifest) -> bool:
    """Whether a result is of the run, complete or not, and of the same model."""
    found = (ds.attrs.get("study_sha256"), ds.attrs.get("model_sha256"))
    return found == (manifest.study_sha256, manifest.model_sha256)


class Survey(NamedTuple):
    """Flat indices of the scenarios that are missing, the environments that computed the others, how far chains are."""

    missing: np.ndarray
    environments: list[dict[str, str]]
    reached: Reached


@dataclass(frozen=True)
class Computed:
    """What a folder has of a study.

    earlier: the results of a smaller version, of which the scenarios ``match`` are in the study too; ``None`` without.
    """

    study: Study
    shards: Shards
    earlier: xr.Dataset | None
    match: Match

    @classmethod
    def find(cls, folder: StudyFolder, study: Study, manifest: Manifest) -> Computed:
        """Find it; results of another model do not count.

        Raises
        ------
        InputError
            If the study is no extension of the results.
        IntegrityError
            If they are damaged.
        """
        shards, nothing = folder.shards(manifest), Match(np.array([], dtype=np.int64), np.array([], dtype=np.int64))
        if not folder.has_results:
            return cls(study, shards, None, nothing)
        results = folder.open_results()
        if not same_model(str(results.attrs.get("model_sha256")), manifest.model_sha256):
            return cls(study, shards, None, nothing)
        match = match_scenarios(study.plan, study_attributes(study, manifest), results)
        # damaged traces must not be written again with a hash of their own
        problems = find_problems(results, folder.path, manifest)
        if problems:
            raise IntegrityError("\n".join(problems))
        return cls(study, shards, results, match)

    def survey(self) -> Survey:
        """What is to be run, and where the rest was computed; damaged shards are moved to quarantine."""
        done = np.zeros(self.study.plan.n_scenarios, dtype=bool)
        done[self.match.new] = True
        environments = environments_of(self.earlier) if self.earlier is not None and self.match.new.size else []
        reached = Reached.of(self.study.plan)
        for part in self.shards.read(quarantine=True, leave_out={*METRICS, *TRACES}):
            index = part["scenario"].values
            done[index[index < done.size]] = True  # what is beyond is reported when the parts are joined
            reached.take(part)
            environments += [each for each in environments_of(part) if each not in environments]
        return Survey(np.flatnonzero(~done), environments, reached)

    def parts(self, leave_out: Collection[str] = (), *, quarantine: bool = True) -> Iterator[xr.Dataset]:
        """All parts, without the variables ``leave_out``: the earlier results and the shards.

        Each scenario once: after a merge that was killed before it removed the shards, it is in both.
        """
        parts = self.shards.read(quarantine=quarantine, leave_out={*leave_out, END_STATE})
        if self.earlier is not None and self.match.new.size:
            # foretold anew for the whole study
            names = [n for n in self.earlier.data_vars if n not in leave_out and n not in PREDICTIONS]
            parts = chain([as_part(self.earlier[names], self.match, self.study.plan.n_volumes)], parts)
        seen = np.zeros(self.study.plan.n_scenarios, dtype=bool)
        for part in parts:
            index = part["scenario"].values
            self.shards.require_within(part, seen.size)
            yield part.isel(scenario=~seen[index]) if seen[index].any() else part
            seen[index] = True
