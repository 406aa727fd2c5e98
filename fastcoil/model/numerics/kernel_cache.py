"""The folder of compiled kernels: a file that is damaged, or that another user may have written, is never loaded.

Loading a kernel runs machine code.  So a folder is used only if its owner and mode keep other users from writing there,
and a file only if its bytes match the SHA-256 in front of them; anything else is compiled again.
"""

import contextlib
import hashlib
import os
import pickle
import re
import shutil
import stat
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import config
from numba.core.caching import Cache
from numba.core.compiler import CompileResult
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from fastcoil.base.errors import StorageError
from fastcoil.base.files import write_atomically
from fastcoil.base.machine import is_writable_by_others, owned_by_other_user

_FORMAT = b"fastcoil kernel 1\n"


class KernelCache(Cache):  # type: ignore[misc]
    """Cache of the kernels of one function, a file for each signature; identity: what a closure closes over."""

    def __init__(self, function: Callable[..., Any], folder: Path, identity: str = "") -> None:
        self._py_func, self._folder, self._identity = function, folder, identity
        self._stem = f"{function.__module__}.{function.__qualname__}".replace("<locals>.", "")
        self._settings = _numba_settings()
        self._source = hashlib.sha256(Path(function.__code__.co_filename).read_bytes()).hexdigest()
        self.enable()

    @property
    def cache_path(self) -> str:
        """The folder, under the name that Numba uses."""
        return str(self._folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the kernel for a signature, or return ``None``."""
        # all that machine code needs; a compilation loads the rest, which takes a quarter of a second
        rtsys.initialize(target_context)
        key = self._key(sig, target_context.codegen())
        try:
            stored_key, reduced = pickle.loads(_read_checked(self._path(key)))
            return CompileResult._rebuild(target_context, *reduced) if stored_key == key else None
        except Exception:  # missing, damaged, or of a class that no longer exists
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled kernel, unless it is valid in this process only."""
        if not self._enabled or data.lifted or data.library.has_dynamic_globals:
            return
        if self._settings != _numba_settings():  # user code has changed them since: the folder is that of others
            return
        key = self._key(sig, data.codegen)
        *parts, environments = data._reduce()
        # no kernel uses those of Numba's functions, and loading one imports what compiles them, which takes 0.04 s
        used = tuple(env for env in environments if not env.globals["__name__"].startswith("numba."))
        path, payload = self._path(key), dumps((key, (*parts, used)))
        try:
            _make_private(self._folder)
            write_atomically(path, _header(path, payload) + payload)
        except (OSError, StorageError) as error:
            _warn_uncached(f"{self._folder} cannot be written ({error.__cause__ or error})")

    def _key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        overload_key = (self._identity, sig, codegen.magic_tuple()) if self._identity else self._index_key(sig, codegen)
        return (self._source, self._py_func.__code__.co_firstlineno, overload_key)

    def _path(self, key: tuple[Any, ...]) -> Path:
        # two types may read alike: the key in the file decides
        return self._folder / f"{self._stem}-{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"


def _numba_settings() -> dict[str, str]:
    """Return the settings of Numba, updated from the environment."""
    config.reload_config()  # type: ignore[no-untyped-call]
    return {name: repr(value) for name, value in vars(config).items() if name.isupper()}


@cache
def kernel_folder(fingerprint: str) -> Path | None:
    """Return the folder of the kernels with a fingerprint, made if missing; None, with a warning, if unsafe."""
    cache_home = Path(os.environ.get("XDG_CACHE_HOME", ""))
    # the standard ignores a relative path, which would depend on the current folder
    base = cache_home if cache_home.is_absolute() else Path(os.path.expanduser("~")) / ".cache"
    folder = base / "fastcoil" / "kernels" / fingerprint
    problem = _folder_problem(folder)
    if problem:
        _warn_uncached(f"{folder} {problem}")
        return None
    with contextlib.suppress(OSError):
        os.utime(folder)
        _prune_folders(folder)
    return folder


def _folder_problem(folder: Path) -> str:
    """Create a folder if missing, and return why it is not used: other users may write to it, or it cannot be made."""
    if not folder.is_absolute():
        return "is in no home"
    try:
        for each in (*reversed(folder.parents[:2]), folder):
            _make_private(each)
            if owned_by_other_user(each.stat()):
                return "belongs to another user"
        status = folder.lstat()
    except OSError as error:
        return f"cannot be made ({error.strerror})"
    if stat.S_ISLNK(status.st_mode):
        return "is a symbolic link"
    return "can be written by other users" if is_writable_by_others(status) else ""


def _read_checked(path: Path) -> bytes:
    """Read the content of a file; raise ``OSError`` if it is missing, ``ValueError`` if it is damaged."""
    data = path.read_bytes()
    n = len(_FORMAT) + hashlib.sha256().digest_size
    if data[:n] != _header(path, data[n:]):
        raise ValueError("damaged")
    return data[n:]


def _header(path: Path, payload: bytes) -> bytes:
    """Format and hash, also of the name: a kernel under another name or in another folder counts as damaged."""
    return _FORMAT + hashlib.sha256(f"{path.parent.name}/{path.name}\0".encode() + payload).digest()


def _make_private(folder: Path) -> None:
    """Create a folder, and those above it, for this user only."""
    for each in (*reversed(folder.parents), folder):
        each.mkdir(mode=0o700, exist_ok=True)


@cache
def _warn_uncached(reason: str) -> None:
    cure = "fix it, or set XDG_CACHE_HOME to a folder that only you can write to"
    warnings.warn(f"every process compiles the kernels again: {reason}: {cure}", stacklevel=2)


def _prune_folders(current: Path) -> None:
    """Remove all but the four most recently used folders; a process that needs an older one compiles again."""
    folders = [f for f in current.parent.iterdir() if re.fullmatch(r"[0-9a-f]{16}", f.name) and not f.is_symlink()]
    for folder in sorted(folders, key=lambda f: f.stat().st_mtime)[:-4]:
        if folder != current:
            shutil.rmtree(folder, ignore_errors=True)
