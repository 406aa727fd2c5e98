"""``run.json``: what the run in a folder computes, in hashes, where it was computed, and which files came of it."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import commit, exists, read_bytes, storage_errors
from fastcoil.model.user_rules import RuleHashes, joined, own_code_of
from fastcoil.study.file.spec import Study

MANIFEST = "run.json"
FORMAT = 2
"""Of the folder; later ones are refused."""
_FIRST_FORMAT = 1
"""Of version 0.1: it has no hashes of files and no checksum."""
_CHECKSUM = "sha256"
_LARGEST = 2**20

Environment = Mapping[str, str]
"""On what the bits of a result depend besides the sources, see ``compiled_for``; empty if nobody recorded it."""


@dataclass(frozen=True)
class Manifest:
    """What a run computes, by which two runs are compared, and what is known of it so far.

    relative_to: folder from which the study's relative paths start.  computed_on: every environment that computed a
    part of it.  outputs: for each final file the SHA-256 that its bytes may have, that of the newest first; while a
    file is being replaced, there are two.  finished: whether the results are complete; ``None`` in a folder of
    version 0.1, which does not say.  own_code: what its own rules do, where they were compiled; empty in older folders.
    """

    study_sha256: str
    boundary_sha256: str
    model_sha256: str
    relative_to: str
    computed_on: Sequence[Environment] = field(default=(), compare=False)
    outputs: Mapping[str, Sequence[str]] = field(default_factory=dict, compare=False)
    finished: bool | None = field(default=False, compare=False)
    own_code: RuleHashes = field(default_factory=dict, compare=False)

    @classmethod
    def of(cls, study: Study, model_sha256: str) -> Manifest:
        """The manifest of a study, run with these sources of the model."""
        boundary = study.plan.layout.boundary
        own_code = own_code_of(study.plan.layout.loop.rules.values())
        return cls(study.sha256, boundary.sha256, model_sha256, str(study.folder.absolute()), own_code=own_code)

    @property
    def key(self) -> str:
        """Names the shards that belong to this run."""
        return hashlib.sha256(f"1 {self.study_sha256} {self.model_sha256}".encode()).hexdigest()

    def knowing(self, earlier: Manifest | None) -> Manifest:
        """The same run, with what ``earlier``, the run in the folder so far, knows of the files there."""
        if earlier is None:
            return self
        same = (self.study_sha256, self.model_sha256) == (earlier.study_sha256, earlier.model_sha256)
        own_code = joined(self.own_code, earlier.own_code) if same else self.own_code
        return replace(self, outputs=earlier.outputs, own_code=own_code)

    @classmethod
    def read(cls, folder: Path) -> Manifest | None:
        """Read ``run.json``; ``None`` if there is none.

        Raises
        ------
        StorageError, IntegrityError
            If it cannot be read; if it cannot be understood.
        """
        path = folder / MANIFEST
        if not exists(path):
            return None
        try:
            with storage_errors(path, "read"):
                data = read_bytes(path, _LARGEST)
            found = json.loads(data)
            format = found.pop("format", 0)
            if format not in (_FIRST_FORMAT, FORMAT):
                raise IntegrityError(
                    f"{folder} was written by another version of fastcoil (format {format}, this one "
                    f"writes {FORMAT}): use that version, or choose another folder with -o"
                )
            if format == FORMAT and found.pop(_CHECKSUM, None) != checksum(found):
                raise ValueError("its checksum differs")
            manifest = cls(**found) if format == FORMAT else cls(**found, finished=None)
            _check(manifest)
            return manifest
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            raise IntegrityError(
                f"{path} is damaged ({error}): delete it and run the study again, or choose another folder with -o"
            ) from error

    @property
    def text(self) -> str:
        """The content of ``run.json``."""
        content = asdict(self)
        return json.dumps({**content, "format": FORMAT, _CHECKSUM: checksum(content)}, indent=1) + "\n"

    def write(self, folder: Path) -> None:
        """Write ``run.json``."""
        commit(folder / MANIFEST, self.text.encode())


def checksum(content: Mapping[str, Any]) -> str:
    """SHA-256 of a table, by which a later change of it is seen."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _check(manifest: Manifest) -> None:
    """Refuse values of the wrong type.

    Raises
    ------
    ValueError
        If there is one.
    """
    for name in ("study_sha256", "boundary_sha256", "model_sha256", "relative_to"):
        if not isinstance(getattr(manifest, name), str):
            raise ValueError(f"{name} is no text")
    f"{manifest.study_sha256}{manifest.boundary_sha256}{manifest.model_sha256}".encode()
    if "\0" in os.fsdecode(os.fsencode(manifest.relative_to)):
        raise ValueError("relative_to is no path")
    if not _is_list(manifest.computed_on, lambda each: isinstance(each, dict) and _is_list([*each.values()], _is_text)):
        raise ValueError("computed_on is no list of environments")
    outputs = manifest.outputs
    if not isinstance(outputs, dict) or not all(_is_list(hashes, _is_text) for hashes in outputs.values()):
        raise ValueError("outputs are no lists of hashes")
    own_code = manifest.own_code
    if not isinstance(own_code, dict) or not all(
        isinstance(each, dict) and _is_list([*each.values()], _is_text) for each in own_code.values()
    ):
        raise ValueError("own_code is no table of hashes")
    if manifest.finished not in (True, False, None):
        raise ValueError("finished is neither true nor false")


def _is_list(value: object, holds: Any) -> bool:
    return isinstance(value, list | tuple) and all(map(holds, value))


def _is_text(value: object) -> bool:
    return isinstance(value, str)
