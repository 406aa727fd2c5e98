"""A process as on Windows, as far as Linux can emulate it: what Windows lacks is removed, what it refuses is refused.

``emulate`` is called before fastcoil is imported.  Libraries are imported before, since they have code for Windows: the
compiler, HDF5 and the locks of filelock are those of Linux.
"""

import errno
import os
import shutil
import signal
import stat
import sys
import tempfile
import warnings
from contextlib import suppress
from importlib import import_module
from types import SimpleNamespace

LIBRARIES = (
    "numba", "scipy.optimize", "scipy.signal", "scipy.stats", "xarray", "netCDF4", "filelock", "joblib", "click",
    "pydantic", "rich.console", "rich.progress", "jinja2", "matplotlib.pyplot", "subprocess", "tempfile", "asyncio",
    "multiprocessing", "zipfile", "logging.config", "getpass", "concurrent.futures.thread",
)  # fmt: skip
MISSING_MODULES = ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "posix_ipc", "syslog", "readline")
MISSING_OS_NAMES = (
    "fork", "forkpty", "register_at_fork", "getuid", "geteuid", "getgid", "getegid", "getpgid", "setsid", "killpg",
    "sysconf", "posix_fallocate", "sched_getaffinity", "mkfifo", "chown", "fchown", "chroot", "nice", "getloadavg",
    "O_NONBLOCK", "O_DIRECTORY", "O_NOFOLLOW", "O_NOCTTY", "O_CLOEXEC", "O_SYNC", "O_DSYNC", "pread", "pwrite",
)  # fmt: skip
SIGNALS = {"SIGINT", "SIGTERM", "SIGABRT", "SIGFPE", "SIGILL", "SIGSEGV"}
"""Those of Windows; SIG_DFL and SIG_IGN are no signals."""
MEMORY_BYTES = 3 * 2**30


def emulate(libraries=LIBRARIES):
    """Make this process one of Windows, after importing the libraries."""
    for name in libraries:
        import_module(name)
    assert not [name for name in sys.modules if name.partition(".")[0] == "fastcoil"]
    full_os = SimpleNamespace(**vars(os))
    for name, module in list(sys.modules.items()):
        if name.startswith("filelock.") and getattr(module, "os", None) is os:
            module.os = full_os
    for name in MISSING_MODULES:
        sys.modules[name] = None
    for name in MISSING_OS_NAMES:
        with suppress(AttributeError):
            delattr(os, name)
    for name in dir(signal):
        if name.startswith("SIG") and not name.startswith("SIG_") and name not in SIGNALS:
            delattr(signal, name)
    shutil._use_fd_functions = False
    tempfile.TemporaryFile = tempfile.NamedTemporaryFile  # as there, where no open file loses its name
    _refuse_open_files()
    sys.modules["ctypes"].windll = SimpleNamespace(kernel32=SimpleNamespace(GlobalMemoryStatusEx=_memory_status))
    # a text file opened without an encoding would get that of the country
    warnings.filterwarnings("error", category=EncodingWarning, module=r"fastcoil\.")


def _memory_status(pointer):
    status = pointer._obj
    assert (len(status), status[0] & 0xFFFFFFFF) == (8, 64)
    status[1], status[2] = 4 * MEMORY_BYTES, MEMORY_BYTES
    return 1


def _refuse_open_files():
    """Refuse to open or flush folders, and to replace, rename or remove open files."""
    opened, synced = os.open, os.fsync

    def open_(path, flags, mode=0o777, **options):
        if os.path.isdir(path):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return opened(path, flags, mode, **options)

    def fsync(descriptor):
        if stat.S_ISDIR(os.fstat(descriptor).st_mode):
            raise OSError(errno.EBADF, "Bad file descriptor")
        synced(descriptor)

    def refuse_if_open(change, n_paths):
        def checked(*arguments, **options):
            for path in arguments[:n_paths]:
                if is_open(path):
                    raise PermissionError(errno.EACCES, "Access is denied", str(path))
            return change(*arguments, **options)

        return checked

    os.open, os.fsync = open_, fsync
    for name, n_paths in (("replace", 2), ("rename", 2), ("unlink", 1), ("remove", 1)):
        setattr(os, name, refuse_if_open(getattr(os, name), n_paths))


def is_open(path):
    """Whether this process has a file open, in any library."""
    path, open_paths = os.path.realpath(path), set()
    for name in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            open_paths.add(os.readlink(f"/proc/self/fd/{name}"))
    return path in open_paths
