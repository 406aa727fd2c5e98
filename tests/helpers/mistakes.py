"""Mistakes that the package reports without field or code, recorded while a test runs."""

import functools
import sys
from pathlib import Path

from fastcoil.base.errors import CODES, InputError

PACKAGE = str(Path(sys.modules[InputError.__module__].__file__).parents[1])
incomplete = []
_init = InputError.__init__


@functools.wraps(_init)
def _recording_init(error, *args, **options):
    _init(error, *args, **options)
    if sys._getframe(1).f_code.co_filename.startswith(PACKAGE):
        incomplete.extend(str(p) for p in error.problems if not p.field or p.code not in CODES)


InputError.__init__ = _recording_init
