"""``archive.json``: what an archive holds, with the SHA-256 of every file; and which names its files may have."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

LISTING, README = "archive.json", "README.txt"
INPUTS, HERE = "inputs", "."
"""Folder of the files that the study reads, and where its paths start if it reads none."""
FORMAT = 1
_KIND = "fastcoil archive"
_CHECKSUM = "sha256"
_LONGEST_NAME = 200
"""Bytes of a part of a path."""
_MOST_PARTS = 30


class Entry(NamedTuple):
    """A file: how many bytes, and their SHA-256."""

    size: int
    sha256: str


@dataclass(frozen=True)
class Listing:
    """What an archive holds.

    files: by path in the folder of the study, ``archive.json`` itself left out.  elsewhere: files that the study reads
    by a path that leads nowhere on another machine → the member that has their bytes.  made_with: versions and machine.
    """

    content_sha256: str
    made_with: Mapping[str, Any]
    elsewhere: Mapping[str, str]
    files: Mapping[str, Entry]

    @property
    def data(self) -> bytes:
        """The content of ``archive.json``."""
        content = {
            "kind": _KIND,
            "format": FORMAT,
            "content_sha256": self.content_sha256,
            "made_with": dict(self.made_with),
            "elsewhere": dict(self.elsewhere),
            "files": {name: {"bytes": size, "sha256": sha256} for name, (size, sha256) in self.files.items()},
        }
        return (json.dumps({**content, _CHECKSUM: _checksum(content)}, indent=1, ensure_ascii=False) + "\n").encode()

    @classmethod
    def parse(cls, data: bytes) -> Listing:
        """Read it.

        Raises
        ------
        ValueError
            In words, if it is no such list.
        """
        try:
            found = json.loads(data)
            if found["kind"] != _KIND or type(found["format"]) is not int:
                raise ValueError("is no list of an archive")
            if found["format"] > FORMAT:
                raise ValueError("was written by a later version of fastcoil: check it with that version")
            if found.pop(_CHECKSUM) != _checksum(found):
                raise ValueError("is damaged (its checksum differs)")
            files = {name: Entry(each["bytes"], each["sha256"]) for name, each in found["files"].items()}
            if not all(type(e.size) is int and e.size >= 0 and isinstance(e.sha256, str) for e in files.values()):
                raise TypeError("files")
            listing = cls(str(found["content_sha256"]), dict(found["made_with"]), dict(found["elsewhere"]), files)
        except (KeyError, TypeError, AttributeError, RecursionError, UnicodeDecodeError, json.JSONDecodeError):
            raise ValueError("is damaged (it is no list of an archive)") from None
        return listing


def _checksum(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def is_safe(name: str) -> bool:
    """Whether a path can be unpacked anywhere, and leads nowhere but into the folder it is unpacked in."""
    parts = name.split("/")
    return len(parts) <= _MOST_PARTS and all(
        part not in ("", ".", "..")
        and part.isprintable()
        and not set(part) & set('\\:*?"<>|')
        and len(part.encode(errors="replace")) <= _LONGEST_NAME
        and part == part.strip(" ")
        for part in parts
    )
