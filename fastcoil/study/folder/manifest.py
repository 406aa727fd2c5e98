"""``run.json``: what the run in a folder computes, in hashes."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

from fastcoil.errors import IntegrityError
from fastcoil.files import commit, read_bytes, storage_errors
from fastcoil.study.file.spec import Study

MANIFEST = "run.json"
FORMAT = 1
"""Of the folder; another one is refused."""
_LARGEST = 2**20


@dataclass(frozen=True)
class Manifest:
    """What a run computes.  ``relative_to``: folder from which the study's relative paths start."""

    study_sha256: str
    boundary_sha256: str
    model_sha256: str
    relative_to: str
    format: int = FORMAT

    @classmethod
    def of(cls, study: Study, model_sha256: str) -> Manifest:
        """The manifest of a study, run with these sources of the model."""
        boundary = study.plan.layout.boundary
        return cls(study.sha256, boundary.sha256, model_sha256, str(study.folder.absolute()))

    @property
    def key(self) -> str:
        """Names the shards that belong to this run."""
        return hashlib.sha256(f"{self.format} {self.study_sha256} {self.model_sha256}".encode()).hexdigest()

    @classmethod
    def read(cls, folder: Path) -> Manifest | None:
        """Read ``run.json``; ``None`` if there is none.

        Raises
        ------
        IntegrityError
            If it cannot be understood.
        """
        path = folder / MANIFEST
        if not path.exists():
            return None
        try:
            with storage_errors(path, "read"):
                data = read_bytes(path, _LARGEST)
            found = json.loads(data)
            if found.get("format", 0) != FORMAT:
                raise IntegrityError(
                    f"{folder} was written by another version of fastcoil (format {found.get('format')}, this one "
                    f"writes {FORMAT}): use that version, or choose another folder with -o"
                )
            return cls(**found)
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            raise IntegrityError(f"{path} is damaged ({error}): choose another folder with -o, or delete it") from error

    def write(self, folder: Path) -> None:
        """Write ``run.json``."""
        commit(folder / MANIFEST, (json.dumps(asdict(self), indent=1) + "\n").encode())
