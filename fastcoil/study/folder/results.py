"""What has been computed of a study: opened, matched with a larger version of it, checked."""

from __future__ import annotations

import hashlib
import json
import math
import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fastcoil.base.arguments import require_path
from fastcoil.base.arrays import allocate_on_disk
from fastcoil.base.errors import FastcoilError, InputError, IntegrityError, StorageError
from fastcoil.base.figures import stale_figures
from fastcoil.base.files import exists, is_file, is_folder
from fastcoil.base.machine import available_memory, command_line, format_bytes
from fastcoil.loops.loop import Loop
from fastcoil.loops.netcdf import cut_into_pieces, probe_file
from fastcoil.loops.plan import Plan, simulation_attributes
from fastcoil.loops.provenance import environments_of, provenance
from fastcoil.loops.scenarios import check_result, check_same_form, join_flat, parameter_columns, unflatten
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.metric_table import METRICS, PREDICTIONS, STATUS_NOT_RUN, TRACES
from fastcoil.model.user_rules import RULE_KINDS, refuse_changed_code
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.folder import StudyFolder, refuse_archive
from fastcoil.study.folder.stored import MANIFEST_FILE, RESULTS_FILE, Manifest, Shards, find_problems

_CURE = "give the folder of a study, its results.nc, or a result saved with ds.to_netcdf()"
_SCENARIOS_AT_ONCE, _VALUES_AT_ONCE = 10_000, 2**22  # scenarios; values read of earlier results
_DECISIVE_ATTRIBUTES = {
    "seed": "[run] seed",
    "warm_up_s": "[run] warm_up",
    "carry_over": "[run] carry_over",
    "rng": "the random numbers",
    "traces": "[run] traces",
    "reduction_sha256": "[run] reduce",
}
"""What a scenario depends on besides its parameters and its day: attribute and its name in messages."""


# --- opened -----------------------------------------------------------------------------------------------------------


def open_study(folder: str | Path) -> xr.Dataset:
    """Open the results of a study by its folder, checked against their hash.

    An unfinished study can be opened too: scenarios that are not finished yet have the status ``not_run``.  Traces of
    a finished one stay on the disk until they are asked for.

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
    store = StudyFolder(require_path("folder", folder, "give the folder of a study"))
    return store.settled(lambda: _open_folder(store))


def open_metrics(folder: Path, leave_out: Collection[str] = TRACES) -> xr.Dataset:
    """Open the results of a study without traces, which of an unfinished one would be loaded; raises as it does."""
    store = StudyFolder(folder)
    ds = store.settled(lambda: _open_folder(store, leave_out))
    return ds.drop_vars(leave_out, errors="ignore")


def open_finished(folder: Path) -> xr.Dataset:
    """Open the results of a finished study; ``InputError`` if scenarios are missing, the rest as ``open_study``."""
    ds = open_study(folder)
    n_missing = int((ds["status"].values == STATUS_NOT_RUN).sum())
    if n_missing or "content_sha256" not in ds.attrs:
        n_done = ds["status"].size - n_missing
        command = command_line(["fastcoil", "run", "STUDY.toml", "-o", str(folder)])
        raise InputError(
            f"{folder} is unfinished: {n_done:,} of {ds['status'].size:,} scenarios are done; finish it with `{command}`"
        )
    return ds


def open_results(path: Path) -> xr.Dataset:
    """Open whatever a user has of results: the folder of a study, its results.nc, or a NetCDF file of their own."""
    if is_folder(path):
        return open_study(path)
    if path.name == RESULTS_FILE and exists(path.with_name(MANIFEST_FILE)):
        return open_study(path.parent)
    if not is_file(path):
        raise InputError(f"{path} does not exist: {_CURE}")
    refuse_archive(path)
    try:
        ds = probe_file(path, _CURE).load()
        check_result(ds)
    except (IntegrityError, InputError):
        raise InputError(f"{path} holds no result of fastcoil, or it is damaged: {_CURE}") from None
    return ds


def _open_folder(store: StudyFolder, leave_out: Collection[str] = ()) -> xr.Dataset:
    manifest = store.require_manifest()
    has_shards = Shards(store.path, manifest.key).any()
    if store.has_results:
        ds = store.open_results()
        # with no shard, all that is known of an unfinished study is there
        if is_complete_result_of(ds, manifest) or (is_result_of(ds, manifest) and not has_shards):
            return ds
    elif manifest.finished:
        raise IntegrityError(f"{store.results} is missing: run the study again")
    elif not has_shards:
        raise InputError(f"{store.path} has no finished scenario yet: wait, or run the study")
    study = store.read_study(manifest)
    if study.plan.trace_bytes > available_memory() and not leave_out:
        warnings.warn(
            f"{store.path} is unfinished, and its traces, {format_bytes(study.plan.trace_bytes)}, do not fit into memory: they "
            "are left out",
            stacklevel=4,
        )
        leave_out = TRACES
    parts = ComputedParts.find(store, study, manifest).parts(leave_out, quarantine=False)
    ds = unflatten(join_flat(study.plan.n_scenarios, parts, allocate=allocate_on_disk), study.plan.layout)
    if not ds.data_vars:
        raise InputError(f"{store.path} has no finished scenario yet: wait, or run the study")
    ds.attrs = study_attributes(study, manifest) | {"computed_on": json.dumps(list(manifest.computed_on))}
    return ds


def is_complete_result_of(ds: xr.Dataset, manifest: Manifest) -> bool:
    """Whether a result is that of the run, complete and of the same model."""
    return is_result_of(ds, manifest) and not bool((ds["status"].values == STATUS_NOT_RUN).any())


def is_result_of(ds: xr.Dataset, manifest: Manifest) -> bool:
    """Whether a result is of the run, complete or not, and of the same model."""
    result_hashes = (ds.attrs.get("study_sha256"), ds.attrs.get("model_sha256"))
    return result_hashes == (manifest.study_sha256, manifest.model_sha256)


def study_attributes(study: Study, manifest: Manifest) -> dict[str, Any]:
    """The attributes of the results of a study: provenance, settings, and which study it is."""
    attrs = {
        "title": study.title,
        **provenance(),
        **simulation_attributes(study.plan),
        "summary": study.question,
        "study_toml": study.text,
        "study_sha256": study.sha256,
        "model_sha256": manifest.model_sha256,
    }
    traces = study.plan.traces
    if traces.names:
        attrs["traces"] = f"{', '.join(traces.names)} every {traces.interval} s"
    if study.reduction:
        attrs |= {"reduction": study.reduction.name, "reduction_sha256": study.reduction.sha256}
    if study.rules:
        attrs["rules"] = json.dumps({n: {"code": s.name, "sha256": s.sha256} for n, s in sorted(study.rules.items())})
    if study.precision:
        attrs["precision"] = study.precision.text
    if manifest.user_code:
        attrs["user_code"] = json.dumps(manifest.user_code)
    return attrs


# --- matched ----------------------------------------------------------------------------------------------------------


def match_scenarios(plan: Plan, attrs: dict[str, Any], earlier: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Match the scenarios of an earlier result with those of a plan, by everything their outcome depends on.

    attrs: those that the results of the plan will have.  Returns flat indices, equally many, of the scenarios that were
    run: in the earlier result and in the study.
    """
    differences = [
        words for name, words in _DECISIVE_ATTRIBUTES.items() if str(attrs.get(name)) != str(earlier.attrs.get(name))
    ]
    if attrs.get("model_sha256") != earlier.attrs.get("model_sha256"):
        differences.append("the sources of the model")
    if differences:
        raise InputError(
            f"--extend: {' and '.join(differences)} changed, so that nothing can be kept: choose another folder with -o"
        )
    study_rules, earlier_rules = _rule_hashes(attrs), _rule_hashes(earlier.attrs)
    user_code = json.loads(attrs.get("user_code", "{}"))
    # of a rule with another source the scenarios are no longer in the study
    refuse_changed_code(
        {name: user_code[name] for name in user_code if study_rules.get(name) == earlier_rules.get(name)},
        json.loads(earlier.attrs.get("user_code", "{}")),
    )
    loop = plan.layout.loop
    unknown = sorted(earlier_rules.keys() - loop.rules.keys())
    if unknown:
        raise InputError(
            f"--extend: the rule {unknown[0]} is no longer in the study: keep it, or choose another folder with -o"
        )
    sizes = {str(d): n for d, n in earlier["status"].sizes.items()}
    smaller = Loop.from_dataset(earlier, [loop.rules[name] for name in earlier_rules])
    key_blocks = [*_scenario_keys(loop, plan.layout.sizes, json.loads(attrs["day_sha256"]), study_rules)]
    study_keys = np.concatenate(key_blocks, out=allocate_on_disk((plan.n_scenarios,), 0, key_blocks[0].dtype))
    del key_blocks
    order = np.argsort(study_keys, kind="stable")
    study_keys = np.take(study_keys, order, out=allocate_on_disk(study_keys.shape, 0, study_keys.dtype), mode="clip")
    places = []
    for keys in _scenario_keys(smaller, sizes, json.loads(earlier.attrs["day_sha256"]), earlier_rules):
        positions = np.searchsorted(study_keys, keys, side="right") - 1  # of equal scenarios the last one
        places.append(np.where(study_keys[positions] == keys, order[positions], -1))
    place = np.concatenate(places)
    n_dropped = int((place < 0).sum())
    if n_dropped:
        days_cure = "add days at the end alone, for each goes on from those before it" if plan.carry_over else ""
        design_cure = "a Latin hypercube of another size shares no point: use sobol or random"
        raise InputError(
            f"--extend: {n_dropped:,} of the {place.size:,} scenarios in the folder are no longer in the study: keep "
            f"all values and add to them ({days_cure or design_cure}), or choose another folder with -o"
        )
    done = np.flatnonzero(earlier["status"].values.ravel() != STATUS_NOT_RUN)
    return done, place[done]


def _rule_hashes(attrs: dict[Any, Any]) -> dict[str, str]:
    """The rules of a study's own: name → hash of the code."""
    return {name: rule.get("sha256", "") for name, rule in json.loads(attrs.get("rules", "{}")).items()}


def _scenario_keys(loop: Loop, sizes: dict[str, int], days: list[str], rules: dict[str, str]) -> Iterator[np.ndarray]:
    """A hash of 16 bytes for each scenario, over everything its result depends on, some scenarios at a time."""
    parameters_read = {name: rule.own for name, rule in loop.rules.items()}
    n = int(np.prod(list(sizes.values()), dtype=np.int64))
    for start in range(0, n, _SCENARIOS_AT_ONCE):
        keys = []
        columns = parameter_columns(loop, sizes, np.arange(start, min(start + _SCENARIOS_AT_ONCE, n)))
        rows = np.ascontiguousarray(parameter_matrix(columns).T)
        for k, (row, day) in enumerate(zip(rows, columns["day"], strict=True)):
            words = [str(columns[kind][k]) for kind in RULE_KINDS]
            user_rules = [
                f"{w} {rules[w]} {[(n, float(columns[n][k])) for n in parameters_read[w]]}" for w in words if w in rules
            ]
            keys.append(
                hashlib.blake2b(row.tobytes() + "".join([days[day], *user_rules]).encode(), digest_size=16).digest()
            )
        yield np.array(keys, dtype="S16")


@dataclass(frozen=True)
class ComputedParts:
    """What a folder has of a study.

    earlier: the results of a smaller version, ``None`` without.  old, new: see ``match_scenarios``.
    """

    study: Study
    shards: Shards
    earlier: xr.Dataset | None
    old: np.ndarray
    new: np.ndarray

    @classmethod
    def find(cls, folder: StudyFolder, study: Study, manifest: Manifest) -> ComputedParts:
        """Find it; results of another model do not count.

        ``InputError`` if the study is no extension of the results.  ``IntegrityError`` if they are damaged.
        """
        shards = Shards(folder.path, manifest.key)
        results = folder.open_results() if folder.has_results else None
        if results is None or results.attrs.get("model_sha256") != manifest.model_sha256:
            return cls(study, shards, None, *np.empty((2, 0), dtype=np.int64))
        match = match_scenarios(study.plan, study_attributes(study, manifest), results)
        # damaged traces must not be written again with a hash of their own
        problems = find_problems(results, folder.path, manifest)
        if problems:
            raise IntegrityError("\n".join(problems))
        return cls(study, shards, results if match[1].size else None, *match)

    def survey(self, scenarios: np.ndarray | None = None) -> tuple[np.ndarray, list[dict[str, str]]]:
        """Flat indices of the missing scenarios, and where the others were computed; damaged shards are set aside.

        own: only these scenarios and the shards that begin with one of them, while others write the rest.
        """
        done = np.zeros(self.study.plan.n_scenarios, dtype=bool)
        done[self.new] = True
        environments = [] if self.earlier is None else environments_of(self.earlier)
        for part in self.shards.read(quarantine=scenarios is None, leave_out={*METRICS, *TRACES}, scenarios=scenarios):
            done[part["scenario"].values] = True
            environments += [each for each in environments_of(part) if each not in environments]
        return np.flatnonzero(~done) if scenarios is None else scenarios[~done[scenarios]], environments

    def parts(self, leave_out: Collection[str] = (), *, quarantine: bool = True) -> Iterator[xr.Dataset]:
        """All parts, without the variables ``leave_out``: the earlier results and the shards.

        Each scenario once: after a merge that was killed before it removed the shards, it is in both.
        """
        parts = self.shards.read(quarantine=quarantine, leave_out=leave_out)
        if self.earlier is not None:
            parts = chain(self._earlier_parts(self.earlier, leave_out), parts)
        seen = np.zeros(self.study.plan.n_scenarios, dtype=bool)
        for part in parts:
            index = part["scenario"].values
            yield part.isel(scenario=~seen[index]) if seen[index].any() else part
            seen[index] = True

    def _earlier_parts(self, earlier: xr.Dataset, leave_out: Collection[str]) -> Iterator[xr.Dataset]:
        """The matched scenarios as flat parts; predictions are computed again for the whole study."""
        dims, shape = earlier["status"].dims, earlier["status"].shape
        kept = earlier[[n for n in earlier.data_vars if n not in leave_out and n not in PREDICTIONS]]
        for name in kept.data_vars.keys() - {*TRACES}:  # each once, and not for every piece
            kept[name].load()
        values_per_scenario = max(1, sum(v.size for v in kept.data_vars.values()) // earlier["status"].size)
        end = 0
        for piece in cut_into_pieces(shape, max(1, _VALUES_AT_ONCE // values_per_scenario)):
            block = kept.isel(dict(zip(dims, piece, strict=True)))
            start, end = end, end + math.prod(block.sizes[d] for d in dims)
            in_block = slice(*np.searchsorted(self.old, [start, end]))
            part = xr.Dataset(coords={"scenario": self.new[in_block]})
            for name, variable in block.data_vars.items():
                values = variable.values.reshape(-1, *variable.shape[len(dims) :])
                values = values[self.old[in_block] - start]
                part[name] = (("scenario", *variable.dims[len(dims) :]), values, variable.attrs)
            part = part.assign_coords({n: c for n, c in earlier.coords.items() if n in part.dims and n != "scenario"})
            n_volumes = self.study.plan.n_volumes  # the earlier result may have had only smaller coils
            if "volume" in part.dims and part.sizes["volume"] < n_volumes:
                part = part.reindex(volume=np.arange(1, n_volumes + 1))
            if part.sizes["scenario"]:
                yield part


# --- checked ----------------------------------------------------------------------------------------------------------


def find_folder_problems(store: StudyFolder) -> list[str]:
    """Check every file in a folder: a sentence for each problem.  Nothing is changed.

    ``InputError`` if the folder holds no study.  ``StorageError`` if the results cannot be read.  ``IntegrityError`` if
    ``run.json`` is lost or damaged, so that it is unknown which study the folder holds.
    """
    manifest = store.require_manifest()
    problems: list[str] = []
    try:
        store.read_study(manifest)
    except IntegrityError as error:
        problems = str(error).splitlines()
    problems += find_result_problems(store, manifest)
    return [*problems, *_find_shard_problems(Shards(store.path, manifest.key))]


def find_result_problems(store: StudyFolder, manifest: Manifest) -> Iterator[str]:
    """What is wrong with the final files of a folder, whether or not its study can still be read."""
    if not store.has_results:
        if manifest.finished:
            yield f"{store.results} is missing: run the study again"
        return
    try:
        ds = store.open_results()
        yield from find_problems(ds, store.path, manifest)
    except StorageError:
        raise
    except FastcoilError as error:
        yield str(error)
        return
    if not manifest.finished:
        return
    cure = f"run the study again, with -o {store.path}, which puts it right"
    if not is_complete_result_of(ds, manifest):
        yield f"{store.results} is of another study, or incomplete: {cure}"
    elif (store.read_text() or "").replace("\r\n", "\n") != ds.attrs.get("study_toml"):
        yield f"{store.study} is not the text of the study that was run: {cure}"
    for path in store.trace_files():
        if path.name != ds.attrs.get("trace_file"):
            yield f"{path} is not of this run: {cure}"
    for path in stale_figures(store.path, ds.attrs["content_sha256"]):
        yield f"{path} was drawn from other results: run `fastcoil plot {store.path}`, or delete it"


def _find_shard_problems(shards: Shards) -> Iterator[str]:
    first = None
    for path, part, problem in shards.inspect():
        if part is None:
            yield f"{path} {problem}"
            continue
        try:
            first = check_same_form(first, part)
        except FastcoilError as error:
            yield f"{path}: {error}"
