"""What a power loss may leave of a folder: a model of a disk that keeps only what POSIX promises.

Content is safe after ``fsync`` of the file, a name after ``fsync`` of its folder.  Of what came later anything may be
lost: each write in pieces, each change of a name for itself.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from helpers.calls import Call, Record

_SECTOR = 512
Keep = Callable[[str], bool]
"""Whether a change is kept; called with "names" or "content"."""


@dataclass
class File:
    """safe: what is on the disk for sure; later: changes since, (place, bytes), or (size, None) for a new size."""

    now: bytearray = field(default_factory=bytearray)
    safe: bytes = b""
    later: list[tuple[int, bytes | None]] = field(default_factory=list)

    def change(self, place: int, data: bytes | None) -> None:
        _apply(self.now, place, data)
        self.later.append((place, data))

    def sync(self) -> None:
        self.safe = bytes(self.now)
        self.later.clear()

    def left(self, keep: Keep) -> bytes:
        found = bytearray(self.safe)
        for place, data in self.later:
            if data is None:
                if keep("content"):
                    _apply(found, place, None)
                continue
            for k in range(0, len(data), _SECTOR):
                if keep("content"):
                    _apply(found, place + k, data[k : k + _SECTOR])
        return bytes(found)


@dataclass
class Folder:
    """now, safe: what names mean; later: changes since, name → what it means then (``None``: nothing)."""

    now: dict[str, File | Folder] = field(default_factory=dict)
    safe: dict[str, File | Folder] = field(default_factory=dict)
    later: list[dict[str, File | Folder | None]] = field(default_factory=list)

    def change(self, meanings: dict[str, File | Folder | None]) -> None:
        _rename(self.now, meanings)
        self.later.append(meanings)

    def sync(self) -> None:
        self.safe = dict(self.now)
        self.later.clear()

    def left(self, keep: Keep) -> dict[str, File | Folder]:
        found = dict(self.safe)
        for meanings in self.later:
            if keep("names"):
                _rename(found, meanings)
        return found


class Disk:
    """A folder, empty and safe at first, and what is done to it."""

    def __init__(self, top: Path) -> None:
        self.top, self.root = top, Folder()
        self._open: dict[int, File | Folder] = {}

    @classmethod
    def holding(cls, top: Path) -> Disk:
        """A disk with what is in a folder, all of it safe."""
        disk = cls(top)

        def taken(path: Path) -> File | Folder:
            if not path.is_dir():
                data = path.read_bytes()
                return File(bytearray(data), data)
            found = {p.name: taken(p) for p in path.iterdir()}
            return Folder(dict(found), found)

        disk.root = taken(top)  # type: ignore[assignment]
        return disk

    def do(self, record: Record) -> None:
        """Do what was recorded."""
        call, path = record.call, record.path
        if call is Call.OPEN:
            self._open[record.file] = self._opened(path, record.offset)
        elif call is Call.WRITE:
            self._file(record).change(record.offset, record.first)
        elif call is Call.TRUNCATE:
            self._file(record).change(record.offset, None)
        elif call is Call.SYNC:
            self._open[record.file].sync()
        elif call is Call.CLOSE:
            del self._open[record.file]
        elif call is Call.MKDIR:
            self._parent(path).change({PurePath(path).name: Folder()})
        elif call in (Call.UNLINK, Call.RMDIR):
            self._parent(path).change({PurePath(path).name: None})
        elif call is Call.RENAME:
            source, target = self._parent(path), PurePath(record.second.decode())
            assert source is self._parent(target), "a rename between folders"
            name = PurePath(path).name
            source.change({name: None, target.name: source.now[name]})

    def left(self, keep: Keep) -> dict[str, bytes | None]:
        """What is found after a power loss: path → bytes, ``None`` for a folder."""
        found: dict[str, bytes | None] = {}

        def look(folder: Folder, place: PurePath) -> None:
            for name, node in sorted(folder.left(keep).items()):
                path = place / name
                found[str(path)] = None if isinstance(node, Folder) else node.left(keep)
                if isinstance(node, Folder):
                    look(node, path)

        look(self.root, PurePath())
        return found

    def _opened(self, path: str, flags: int) -> File | Folder:
        if flags & os.O_TMPFILE == os.O_TMPFILE:
            return File()
        if PurePath(path) == self.top:
            return self.root
        parent, name = self._parent(path), PurePath(path).name
        if name not in parent.now:
            parent.change({name: File()})
        node = parent.now[name]
        if flags & os.O_TRUNC and isinstance(node, File) and node.now:
            node.change(0, None)
        return node

    def _parent(self, path: str | PurePath) -> Folder:
        node: File | Folder = self.root
        for name in PurePath(path).relative_to(self.top).parts[:-1]:
            assert isinstance(node, Folder)
            node = node.now[name]
        assert isinstance(node, Folder)
        return node

    def _file(self, record: Record) -> File:
        file = self._open[record.file]
        assert isinstance(file, File)
        return file


def everything(_: str) -> bool:
    """Nothing is lost: the process was killed."""
    return True


def nothing(_: str) -> bool:
    """Only what is safe."""
    return False


def only_names(kind: str) -> bool:
    """Names as they were, files empty: what a file system does that writes its journal first."""
    return kind == "names"


def anything(seed: int) -> Keep:
    """A choice of everything that could happen."""
    dice = random.Random(seed)
    share = dice.choice((0.2, 0.5, 0.9))
    return lambda _: dice.random() < share


def lay_out(found: dict[str, bytes | None], folder: Path) -> None:
    """Make a folder that holds what a power loss left."""
    folder.mkdir()
    for name, data in found.items():
        if data is None:
            (folder / name).mkdir()
        else:
            (folder / name).write_bytes(data)


def moments(records: Sequence[Record]) -> list[int]:
    """Numbers of the records after which the disk is another one: of many writes in a row the first and the last."""
    calls = [r.call for r in records] + [Call.CLOSE]
    quiet = (Call.CLOSE, Call.MARK)
    found = [
        k
        for k, call in enumerate(calls[:-1])
        if call not in quiet and not calls[max(0, k - 1)] == call == calls[k + 1] == Call.WRITE
    ]
    return [*found, len(records) - 1]


def _apply(content: bytearray, place: int, data: bytes | None) -> None:
    if data is None:
        del content[place:]
        content.extend(bytes(place - len(content)))
    else:
        content.extend(bytes(max(0, place + len(data) - len(content))))
        content[place : place + len(data)] = data


def _rename(names: dict[str, File | Folder], meanings: dict[str, File | Folder | None]) -> None:
    for name, node in meanings.items():
        if node is None:
            names.pop(name, None)
        else:
            names[name] = node
