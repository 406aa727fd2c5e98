"""What the folder of a study holds, read once, and what is left to do of a study in it."""

from __future__ import annotations

import hashlib
import json
import math
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import chain
from typing import Any, NoReturn

import numpy as np
import xarray as xr

from fastcoil.base.arrays import allocate_on_disk
from fastcoil.base.errors import InputError, IntegrityError
from fastcoil.loops.loop import Loop
from fastcoil.loops.netcdf import cut_into_pieces
from fastcoil.loops.plan import Plan
from fastcoil.loops.provenance import environments_of
from fastcoil.loops.scenarios import check_same_form, parameter_columns
from fastcoil.model.engine.lanes import parameter_matrix
from fastcoil.model.metric_table import METRICS, PREDICTIONS, STATUS_NOT_RUN, TRACES
from fastcoil.model.user_rules import RULE_KINDS, RuleHashes, refuse_changed_code
from fastcoil.study.file.spec import Study
from fastcoil.study.folder.folder import StudyFolder
from fastcoil.study.folder.stored import Manifest, Shards, find_problems, open_final_results, study_attributes

_SCENARIOS_AT_ONCE = 10_000  # of which keys are made
_VALUES_AT_ONCE = 2**22  # read of earlier results
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
    """What the folder of a study holds; ``read`` raises ``IntegrityError`` where a file is damaged.

    manifest: of the run in the folder.  results: of the last merge.  has_shards: whether parts wait for a merge.
    """

    store: StudyFolder
    manifest: Manifest | None
    results: xr.Dataset | None
    has_shards: bool

    @classmethod
    def read(cls, store: StudyFolder, manifest: Manifest | None) -> FolderState:
        """Read what is in a folder besides its manifest."""
        results = open_final_results(store.path, manifest) if store.has_results else None
        return cls(store, manifest, results, store.has_shards)

    def stage_of(self, requested: Manifest) -> Stage:
        """Compare what the folder holds with a run."""
        manifest, results = self.manifest, self.results
        if manifest is not None and manifest.study_sha256 != requested.study_sha256:
            if results is None:
                return Stage.UNFINISHED_OTHER if self.has_shards else Stage.NEW
            is_merged = not self.has_shards or is_complete_result_of(results, manifest)
            return Stage.EXTENDABLE if is_merged else Stage.UNFINISHED_OTHER
        if results is not None and is_complete_result_of(results, requested):
            return Stage.FINISHED
        if manifest is not None:
            return Stage.RESUMABLE
        return Stage.NEW if results is None or is_result_of(results, requested) else Stage.UNRECORDED

    def with_stored_batches(self, study: Study, extend: bool) -> Study:
        """Return the study with as many batches of samples as the folder has, or as its extension needs."""
        if self.manifest is None or study.precision is None:
            return study
        n_samples = self.results.sizes.get("sample", 0) if extend and self.results is not None else None
        return study.find_by_hash(self.manifest.study_sha256, n_samples) or study

    def start_run(self, study: Study, extend: bool, scenarios: np.ndarray | None = None) -> StudyRun:
        """Find what is left to do of a study, or of a job slice; refuse one that does not fit what the folder holds."""
        requested = Manifest.from_study(study)
        stage = self.stage_of(requested)
        if stage is Stage.UNRECORDED:
            raise self.store.missing_manifest_error()
        if stage in (Stage.EXTENDABLE, Stage.UNFINISHED_OTHER) and not extend:
            _refuse_other_study(self.store, study)
        if stage is Stage.UNFINISHED_OTHER:
            raise _extension_error(
                f"the study in {self.store.path} is unfinished: finish it with the file that it was started from, then "
                "extend it"
            )
        stored = None if stage is Stage.NEW else self.manifest
        user_code: RuleHashes = {}
        if stage is Stage.FINISHED and self.results is not None:
            user_code = json.loads(self.results.attrs.get("user_code", "{}"))
        elif stored is not None and stored.model_sha256 != requested.model_sha256:
            warnings.warn(
                f"{self.store.path} was computed with other sources of the model: everything is computed again",
                stacklevel=2,
            )
        elif stored is not None and stage is Stage.RESUMABLE:
            user_code = stored.user_code
        refuse_changed_code(requested.user_code, user_code)
        run = StudyRun(self.store, study, requested.with_files_of(stored), scenarios)
        if stage is Stage.FINISHED:
            run.results = self.results
            return run
        run.match(self.results)
        run.find_missing(() if scenarios is None or stored is None else stored.computed_on)
        return run


def _refuse_other_study(store: StudyFolder, study: Study) -> NoReturn:
    """Refuse a study whose folder holds another one, and say which of the two changed."""
    text = store.read_text()
    if text is None:
        raise IntegrityError(
            f"{store.path}: study.toml is missing or damaged, and the run in this folder was of another study: restore "
            "the file, or choose another folder with -o"
        )
    if text.splitlines() == study.text.splitlines():
        raise IntegrityError(
            f"{store.path}: a file that the study reads changed since the run was started: restore it, or choose "
            "another folder with -o; if an extension of it was killed, add --extend to go on"
        )
    raise InputError(
        f"{store.path} holds another study, or another version of this one (compare {store.study_path}): add --extend "
        "if only values were added, otherwise choose another folder with -o",
        "-o",
        "conflict",
    )


def _extension_error(sentence: str) -> InputError:
    return InputError(f"--extend: {sentence}", "--extend", "conflict")


def _no_scenarios() -> np.ndarray:
    return np.empty(0, dtype=np.int64)


@dataclass
class StudyRun:
    """A study in its folder: what is computed of it and what is missing.

    results: of a finished study, None where something is left to do.  earlier: results in the folder of which scenarios
    are kept, those at ``earlier_index`` as those at ``study_index`` of the study.  scenarios: those of a job slice,
    beside which others run the rest.  missing: flat indices to compute.
    """

    store: StudyFolder
    study: Study
    manifest: Manifest
    scenarios: np.ndarray | None = None
    results: xr.Dataset | None = None
    earlier: xr.Dataset | None = None
    earlier_index: np.ndarray = field(default_factory=_no_scenarios)
    study_index: np.ndarray = field(default_factory=_no_scenarios)
    missing: np.ndarray = field(default_factory=_no_scenarios)
    _first_scenario: xr.Dataset | None = None
    _is_recorded: bool = False

    @property
    def shards(self) -> Shards:
        return Shards(self.store.path, self.manifest.key)

    def match(self, results: xr.Dataset | None) -> None:
        """Keep the scenarios of earlier results; those of other sources of the model do not count.

        ``InputError`` if the study is no extension of the results.  ``IntegrityError`` if they are damaged.
        """
        if results is None or results.attrs.get("model_sha256") != self.manifest.model_sha256:
            return
        attrs = study_attributes(self.study, self.manifest)
        self.earlier_index, self.study_index = match_scenarios(self.study.plan, attrs, results)
        # damaged traces must not be written again with a hash of their own
        if problems := find_problems(results, self.store.path, self.manifest):
            raise IntegrityError("\n".join(problems))
        self.earlier = results if self.study_index.size else None

    def find_missing(self, environments: Sequence[Mapping[str, str]]) -> None:
        """Find the scenarios to compute, and where the others were computed; damaged shards are set aside.

        environments: those of other job slices, whose shards are not read.
        """
        scenarios = self.scenarios
        done = np.zeros(self.study.plan.n_scenarios, dtype=bool)
        done[self.study_index] = True
        computed_on = [] if self.earlier is None else environments_of(self.earlier)
        for part in self.shards.read(quarantine=scenarios is None, leave_out={*METRICS, *TRACES}, scenarios=scenarios):
            done[part["scenario"].values] = True
            computed_on += [each for each in environments_of(part) if each not in computed_on]
        computed_on += [dict(each) for each in environments if each not in computed_on]
        self.missing = np.flatnonzero(~done) if scenarios is None else scenarios[~done[scenarios]]
        self.manifest = replace(self.manifest, computed_on=computed_on, finished=False)

    def record(self) -> None:
        """Write into the folder which study is run, unless it says so."""
        if not self._is_recorded and not self.store.has_recorded(self.manifest, self.study.text):
            self.store.write_manifest(self.manifest, self.study.text)
        self._is_recorded = True

    def commit(self, part: xr.Dataset) -> None:
        """Write the results of a shard, and before them a manifest that names the environment that computed them."""
        for environment in environments_of(part):
            if environment not in self.manifest.computed_on:
                self._warn_other_environment(environment)
                self.manifest = replace(self.manifest, computed_on=[*self.manifest.computed_on, environment])
                self._is_recorded = False
        self.record()
        # a copy: the shard itself need not be kept
        self._first_scenario = check_same_form(self._first_scenario, part).isel(scenario=[0])
        self.shards.commit(part)

    def _warn_other_environment(self, environment: Mapping[str, str]) -> None:
        for recorded in self.manifest.computed_on:
            values = {name: (recorded.get(name, "unknown"), environment.get(name, "unknown"))
                      for name in sorted({*recorded, *environment})}  # fmt: skip
            differences = [f"{name} {was}, now {is_now}" for name, (was, is_now) in values.items() if was != is_now]
            warnings.warn(
                f"a part of {self.store.path} was computed elsewhere ({'; '.join(differences)}): the last digits of "
                "results may depend on that, in a loop that hunts also the first; to have all from one place, run the "
                "study in another folder",
                stacklevel=4,
            )

    def parts(self, leave_out: Collection[str] = (), *, quarantine: bool = True) -> Iterator[xr.Dataset]:
        """Read all parts, without the variables ``leave_out``: the earlier results and the shards.

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
            in_block = slice(*np.searchsorted(self.earlier_index, [start, end]))
            part = xr.Dataset(coords={"scenario": self.study_index[in_block]})
            for name, variable in block.data_vars.items():
                values = variable.values.reshape(-1, *variable.shape[len(dims) :])
                values = values[self.earlier_index[in_block] - start]
                part[name] = (("scenario", *variable.dims[len(dims) :]), values, variable.attrs)
            part = part.assign_coords({n: c for n, c in earlier.coords.items() if n in part.dims and n != "scenario"})
            n_volumes = self.study.plan.n_volumes  # the earlier result may have had only smaller coils
            if "volume" in part.dims and part.sizes["volume"] < n_volumes:
                part = part.reindex(volume=np.arange(1, n_volumes + 1))
            if part.sizes["scenario"]:
                yield part


# --- scenarios of earlier results -------------------------------------------------------------------------------------


def match_scenarios(plan: Plan, attrs: dict[str, Any], earlier: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    """Match the scenarios of an earlier result with those of a plan, by everything their outcome depends on.

    attrs: those that the results of the plan will have.  Returns flat indices, equally many, of the scenarios that were
    run: in the earlier result and in the study.
    """
    changed = [
        label for name, label in _DECISIVE_ATTRIBUTES.items() if str(attrs.get(name)) != str(earlier.attrs.get(name))
    ]
    if attrs.get("model_sha256") != earlier.attrs.get("model_sha256"):
        changed.append("the sources of the model")
    if changed:
        raise _extension_error(
            f"{' and '.join(changed)} changed, so that nothing can be kept: choose another folder with -o"
        )
    rules, earlier_rules = _rule_hashes(attrs), _rule_hashes(earlier.attrs)
    user_code = json.loads(attrs.get("user_code", "{}"))
    # of a rule with another source the scenarios are no longer in the study
    refuse_changed_code(
        {name: user_code[name] for name in user_code if rules.get(name) == earlier_rules.get(name)},
        json.loads(earlier.attrs.get("user_code", "{}")),
    )
    loop = plan.layout.loop
    if unknown := sorted(earlier_rules.keys() - loop.rules.keys()):
        raise _extension_error(
            f"the rule {unknown[0]} is no longer in the study: keep it, or choose another folder with -o"
        )
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
        raise _extension_error(
            f"{n_dropped:,} of the {place.size:,} scenarios in the folder are no longer in the study: keep all values "
            f"and add to them ({cure}), or choose another folder with -o"
        )
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
