"""What the folder of a study holds, read once, and what is left to do of a study in it."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, NoReturn

import numpy as np
import xarray as xr

from fastcoil.base.arrays import allocate_on_disk
from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.loops.loop import Loop
from fastcoil.loops.plan import Plan
from fastcoil.loops.provenance import environments_of
from fastcoil.loops.scenarios import parameter_columns
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.metric_table import METRICS, STATUS_NOT_RUN, TRACES
from fastcoil.model.numerics.jit import model_sha256
from fastcoil.model.user_rules import RULE_KINDS, RuleHashes, hash_user_code
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.merged import StudyRun

from fastcoil.study.folder.stored import (  # isort: skip
    Manifest, find_problems, finished_manifest, open_final_results, study_attributes,
)  # fmt: skip

_SCENARIOS_AT_ONCE = 10_000  # of which keys are made
_DECISIVE_ATTRIBUTES = {
    "seed": "[run] seed",
    "warm_up_s": "[run] warm_up",
    "carry_over": "[run] carry_over",
    "rng": "the random numbers",
    "traces": "[run] traces",
    "reduction_sha256": "[run] reduce",
}
"""What a scenario depends on besides its parameters and its day: attribute and its name in messages."""


def is_complete_result_of(ds: xr.Dataset, manifest: Manifest) -> bool:
    """Whether a result is that of the run, complete and of the same model."""
    return is_result_of(ds, manifest) and not bool((ds["status"].values == STATUS_NOT_RUN).any())


def is_result_of(ds: xr.Dataset, manifest: Manifest) -> bool:
    """Whether a result is of the run, complete or not, and of the same model."""
    hashes = ds.attrs.get("study_sha256"), ds.attrs.get("model_sha256")
    return hashes == (manifest.study_sha256, manifest.model_sha256)


class Stage(Enum):
    """What a folder holds, seen from a study that is to be run into it."""

    NEW = "nothing, or a run that ended before its first scenario"
    RESUMABLE = "the study, unfinished or computed with other sources of the model"
    FINISHED = "the complete results of the study"
    EXTENDABLE = "the results of another study"
    UNFINISHED_OTHER = "another study with shards that are not merged"
    UNRECORDED = "results of another study without a manifest"


@dataclass(frozen=True)
class FolderState:
    """What the folder of a study holds: manifest, results of the last merge, and whether shards wait for a merge."""

    store: StudyFolder
    manifest: Manifest | None
    results: xr.Dataset | None
    has_shards: bool

    @classmethod
    def read(cls, store: StudyFolder) -> FolderState:
        manifest = Manifest.read(store.path)
        results = open_final_results(store.path, manifest) if store.has_results else None
        return cls(store, manifest, results, store.has_shards)

    @property
    def is_merged(self) -> bool:
        """Whether the results hold all that was computed."""
        if self.manifest is None or self.results is None:
            return not self.has_shards
        return not self.has_shards or is_complete_result_of(self.results, self.manifest)

    def stage_of(self, requested: Manifest) -> Stage:
        """Compare what the folder holds with a run."""
        manifest, results = self.manifest, self.results
        if manifest is not None and manifest.study_sha256 != requested.study_sha256:
            if not self.is_merged:
                return Stage.UNFINISHED_OTHER
            return Stage.NEW if results is None else Stage.EXTENDABLE
        if results is not None and is_complete_result_of(results, requested):
            return Stage.FINISHED
        if manifest is not None:
            return Stage.RESUMABLE
        return Stage.NEW if results is None or is_result_of(results, requested) else Stage.UNRECORDED

    def start_run(self, study: Study, extend: bool, scenarios: np.ndarray | None = None) -> StudyRun:
        """Find what is left to do of a study or job slice, in the folder's batches; refuse what does not fit it."""
        study, results = self._with_stored_batches(study, extend), self.results
        boundary_sha256 = study.plan.layout.boundary.sha256
        manifest = Manifest(study.sha256, boundary_sha256, model_sha256(), str(study.folder.absolute()))
        stage = self.stage_of(manifest)
        if stage is Stage.UNRECORDED:
            raise self.store.missing_manifest_error()
        if stage in (Stage.EXTENDABLE, Stage.UNFINISHED_OTHER) and not extend:
            _refuse_other_study(self.store, study)
        if stage is Stage.UNFINISHED_OTHER:
            cure = "finish it with the file that it was started from, then extend it"
            raise _extension_error(f"the study in {self.store.path} is unfinished: {cure}")
        stored = None if stage is Stage.NEW else self.manifest
        if stage is not Stage.FINISHED and stored is not None and stored.model_sha256 != manifest.model_sha256:
            sentence = f"{self.store.path} was computed with other sources of the model: everything is computed again"
            warnings.warn(sentence, stacklevel=2)
        user_code = hash_user_code(study.plan.layout.loop.rules.values(), self._earlier_code(study, manifest))
        manifest = replace(manifest, outputs=stored.outputs if stored else {}, user_code=user_code)
        if stage is Stage.FINISHED and results is not None:
            return StudyRun(self.store, study, finished_manifest(results, self.store.path, manifest), results)
        run = self.keep_scenarios(study, manifest)
        _find_missing(run, scenarios, stored.computed_on if stored and scenarios is not None else ())
        return run

    def _earlier_code(self, study: Study, manifest: Manifest) -> RuleHashes:
        """Return the hashes of the user's code with which the scenarios were computed that the run keeps."""
        code: dict[str, Mapping[str, str]] = {}
        if self.results is not None and self.results.attrs.get("model_sha256") == manifest.model_sha256:
            sources = _rule_hashes(self.results.attrs)
            code = json.loads(self.results.attrs.get("user_code", "{}"))
            # of a rule with another source the scenarios are no longer in the study
            code = {n: code[n] for n in code if n in study.rules and study.rules[n].sha256 == sources.get(n)}
        if self.manifest is not None and self.manifest.key == manifest.key:
            code |= {n: {**code.get(n, {}), **hashes} for n, hashes in self.manifest.user_code.items()}
        return code

    def _with_stored_batches(self, study: Study, extend: bool) -> Study:
        if self.manifest is None or study.precision is None:
            return study
        n_samples = self.results.sizes.get("sample", 0) if extend and self.results is not None else None
        stored = study.find_by_hash(self.manifest.study_sha256, n_samples)
        return stored if stored is not None and stored.batches > study.batches else study

    def keep_scenarios(self, study: Study, manifest: Manifest) -> StudyRun:
        """Return a run that keeps the scenarios of the results; those of other sources of the model do not count."""
        run, results = StudyRun(self.store, study, manifest), self.results
        if results is None or results.attrs.get("model_sha256") != manifest.model_sha256:
            return run
        run.earlier_index, run.study_index = match_scenarios(study.plan, study_attributes(study, manifest), results)
        # damaged traces must not be written again with a hash of their own
        if problems := find_problems(results, self.store.path, manifest):
            raise IntegrityError("\n".join(problems))
        run.earlier = results if run.study_index.size else None
        return run


def _find_missing(run: StudyRun, scenarios: np.ndarray | None, environments: Sequence[Mapping[str, str]]) -> None:
    """Find the scenarios to compute, and where the others were computed, for a job slice ``environments``."""
    is_done = np.zeros(run.study.plan.n_scenarios, dtype=bool)
    is_done[run.study_index] = True
    computed_on = [] if run.earlier is None else environments_of(run.earlier)
    for part in run.shards.read(quarantine=scenarios is None, leave_out={*METRICS, *TRACES}, scenarios=scenarios):
        is_done[part["scenario"].values] = True
        computed_on += [each for each in environments_of(part) if each not in computed_on]
    computed_on += [dict(each) for each in environments if each not in computed_on]
    run.missing = np.flatnonzero(~is_done) if scenarios is None else scenarios[~is_done[scenarios]]
    run.manifest = replace(run.manifest, computed_on=computed_on)


def _refuse_other_study(store: StudyFolder, study: Study) -> NoReturn:
    """Refuse a study whose folder holds another one, and say which of the two changed."""
    text = store.read_text()
    if text is None:
        sentence = f"{store.path}: study.toml is missing or damaged, and the run in this folder was of another study"
        raise IntegrityError(f"{sentence}: restore the file, or choose another folder with -o")
    if text.splitlines() == study.text.splitlines():
        cure = "restore it, or choose another folder with -o; if an extension of it was killed, add --extend to go on"
        raise IntegrityError(f"{store.path}: a file that the study reads changed since the run was started: {cure}")
    sentence = f"{store.path} holds another study, or another version of this one (compare {store.study_path})"
    cure = "add --extend if only values were added, otherwise choose another folder with -o"
    raise InputError(f"{sentence}: {cure}", "-o", "conflict")


def _extension_error(sentence: str) -> InputError:
    return InputError(f"--extend: {sentence}", "--extend", "conflict")


# --- scenarios of earlier results -------------------------------------------------------------------------------------


def match_scenarios(plan: Plan, attrs: dict[str, Any], earlier: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Match the scenarios run in an earlier result with those of a plan; return both flat indices, equally many."""
    changed = [
        label for name, label in _DECISIVE_ATTRIBUTES.items() if str(attrs.get(name)) != str(earlier.attrs.get(name))
    ]
    if attrs.get("model_sha256") != earlier.attrs.get("model_sha256"):
        changed.append("the sources of the model")
    if changed:
        sentence = f"{' and '.join(changed)} changed, so that nothing can be kept"
        raise _extension_error(f"{sentence}: choose another folder with -o")
    loop, rules, earlier_rules = plan.layout.loop, _rule_hashes(attrs), _rule_hashes(earlier.attrs)
    if unknown := sorted(earlier_rules.keys() - loop.rules.keys()):
        sentence = f"the rule {unknown[0]} is no longer in the study: keep it"
        raise _extension_error(f"{sentence}, or choose another folder with -o")
    sizes = {str(d): n for d, n in earlier["status"].sizes.items()}
    smaller = Loop.from_dataset(earlier, [loop.rules[name] for name in earlier_rules])
    blocks = [*_scenario_keys(loop, plan.layout.sizes, json.loads(attrs["day_sha256"]), rules)]
    keys = np.concatenate(blocks, out=allocate_on_disk((plan.n_scenarios,), 0, blocks[0].dtype))
    del blocks
    order = np.argsort(keys, kind="stable")
    keys = np.take(keys, order, out=allocate_on_disk(keys.shape, 0, keys.dtype), mode="clip")
    places = []
    for block in _scenario_keys(smaller, sizes, json.loads(earlier.attrs["day_sha256"]), earlier_rules):
        at = np.searchsorted(keys, block, side="right") - 1  # of equal scenarios the last one
        places.append(np.where(keys[at] == block, order[at], -1))
    place = np.concatenate(places)
    if n_dropped := int((place < 0).sum()):
        cure = "a Latin hypercube of another size shares no point: use sobol or random"
        if plan.carry_over:
            cure = "add days at the end alone, for each goes on from those before it"
        sentence = f"{n_dropped:,} of the {place.size:,} scenarios in the folder are no longer in the study"
        cure = f"keep all values and add to them ({cure}), or choose another folder with -o"
        raise _extension_error(f"{sentence}: {cure}")
    done = np.flatnonzero(earlier["status"].values.ravel() != STATUS_NOT_RUN)
    return done, place[done]


def _rule_hashes(attrs: dict[Any, Any]) -> dict[str, str]:
    """The user's own rules: name → hash of the code."""
    return {name: rule.get("sha256", "") for name, rule in json.loads(attrs.get("rules", "{}")).items()}


def _scenario_keys(loop: Loop, sizes: dict[str, int], days: list[str], rules: dict[str, str]) -> Iterator[np.ndarray]:
    """A hash of 16 bytes for each scenario, over everything its result depends on, some scenarios at a time."""
    parameters = {name: rule.own for name, rule in loop.rules.items()}
    n = int(np.prod(list(sizes.values()), dtype=np.int64))
    for start in range(0, n, _SCENARIOS_AT_ONCE):
        keys = []
        columns = parameter_columns(loop, sizes, np.arange(start, min(start + _SCENARIOS_AT_ONCE, n)))
        rows = np.ascontiguousarray(parameter_matrix(columns).T)
        for k, (row, day) in enumerate(zip(rows, columns["day"], strict=True)):
            used = [w for w in (str(columns[kind][k]) for kind in RULE_KINDS) if w in rules]
            texts = [f"{w} {rules[w]} {[(n, float(columns[n][k])) for n in parameters[w]]}" for w in used]
            keys.append(hashlib.blake2b(row.tobytes() + "".join([days[day], *texts]).encode(), digest_size=16).digest())
        yield np.array(keys, dtype="S16")
