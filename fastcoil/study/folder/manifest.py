"""``run.json``: hashes of what a run computes, where it was computed, and which files came of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from fastcoil.base.errors import IntegrityError
from fastcoil.base.files import commit, exists, read_bytes, storage_errors
from fastcoil.model.user_rules import RuleHashes, joined, own_code_of
from fastcoil.study.file.spec import Study

MANIFEST = "run.json"
FORMAT = 2
"""Of the folder; no other one is read."""
_CHECKSUM = "sha256"
_LARGEST = 2**20

Environment = Mapping[str, str]
"""What the bits of a result depend on besides the sources, see ``compiled_for``."""


@dataclass(frozen=True)
class Manifest:
    """What a run computes, by which two runs are compared, and what is known of it so far.

    relative_to: folder from which the study's relative paths start.  computed_on: every environment that computed a
    part of it.  outputs: for each final file the SHA-256 that its bytes may have, that of the newest first; while a
    file is being replaced, there are two.  finished: whether the results are complete.  own_code: hashes of the
    study's own rules, as they were compiled.
    """

    study_sha256: str
    boundary_sha256: str
    model_sha256: str
    relative_to: str
    computed_on: Sequence[Environment] = field(default=(), compare=False)
    outputs: Mapping[str, Sequence[str]] = field(default_factory=dict, compare=False)
    finished: bool = field(default=False, compare=False)
    own_code: RuleHashes = field(default_factory=dict, compare=False)

    @classmethod
    def of(cls, study: Study) -> Manifest:
        """The manifest of a study, run with the model's sources of today."""
        boundary = study.plan.layout.boundary
        own_code = own_code_of(study.plan.layout.loop.rules.values())
        return cls(study.sha256, boundary.sha256, study.model_sha256, str(study.folder.absolute()), own_code=own_code)

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
        """Read ``run.json``; ``None`` if there is none, ``IntegrityError`` if it is damaged or of another format."""
        path = folder / MANIFEST
        if not exists(path):
            return None
        try:
            with storage_errors(path, "read"):
                data = read_bytes(path, _LARGEST)
            found = json.loads(data)
            format = found.pop("format", 0)
            if format != FORMAT and isinstance(format, int):
                raise IntegrityError(
                    f"{folder} was written by another version of fastcoil (format {format}, this one reads and writes "
                    f"{FORMAT}): use that version, or choose another folder with -o"
                )
            if found.pop(_CHECKSUM, None) != checksum(found):
                raise ValueError("its checksum differs")
            return _form().validate_json(json.dumps(found), strict=True)
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            why = "it has values of the wrong type" if isinstance(error, ValidationError) else error
            raise IntegrityError(
                f"{path} is damaged ({why}): delete it and run the study again, or choose another folder with -o"
            ) from error

    @property
    def text(self) -> str:
        """The content of ``run.json``."""
        content = asdict(self)
        return json.dumps({**content, "format": FORMAT, _CHECKSUM: checksum(content)}, indent=1) + "\n"

    def write(self, folder: Path) -> None:
        """Write ``run.json``."""
        commit(folder / MANIFEST, self.text.encode())


@cache
def _form() -> TypeAdapter[Manifest]:
    return TypeAdapter(Manifest)


def checksum(content: Mapping[str, Any]) -> str:
    """SHA-256 of a table, by which a later change of it is seen."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
