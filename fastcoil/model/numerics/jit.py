"""Every compiler flag, with its reason, and what a compiled kernel depends on.  The only file that says njit.

``scalar``  one formula: floats in, floats out, force-inlined into the loops that call it.
``exact``   a scalar whose every rounding is as written: elementary functions, random numbers, and the controller,
            whose decisions are the same in Python.
``section`` a loop over the lanes of a block, force-inlined into its kernel.
``kernel``  a loop over time and lanes: cached on disk, runs without the GIL.  The stages that it calls by their
            address are in ``numerics/stages.py``.
``fma``     a*b + c in one rounding, so that the order of roundings is ours and not the optimiser's.

Flags:
    error_model="numpy"  a division that checks for zero cannot be vectorised.
    forceinline=True     a call in the loop over lanes keeps it scalar.
    nogil=True           threads are the only parallelism: no ``parallel=True``, whose threading layers abort
                         or oversubscribe inside a thread pool.
    no_…_wrapper         entries for C, and of an inlined function for Python, are never called and take a seventh of
                         a compilation.
    fastmath "contract"  a*b + c in one instruction: a third of the arithmetic of Eq (3).  All lanes run the same
                         instructions, so they still get the same bits: see ``tests/model/engine/test_lanes.py``.
    no other fastmath    it deletes NaN tests and lets a lane's bits depend on its neighbours.
    512-bit vectors      where the processor has them.  On Intel's, LLVM would take 256: a quarter more time.
"""

import gc
import hashlib
import inspect
import os
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from numba.core import config
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher, cpu_target
from numba.extending import intrinsic

from fastcoil.model.numerics.kernel_cache import KernelCache, kernel_folder

FLAGS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
_NUMBA_SETTINGS = (
    "BOUNDSCHECK", "CPU_FEATURES", "CPU_NAME", "DISABLE_INTEL_SVML", "DISABLE_JIT", "ENABLE_AVX", "LOOP_VECTORIZE",
    "OPT", "SLP_VECTORIZE",
)  # fmt: skip
"""Settings of Numba, from the environment or its configuration file, that decide what is compiled."""
JIT_ENABLED = not config.DISABLE_JIT  # type: ignore[attr-defined]


def scalar(function: Callable[..., Any]) -> Any:
    """Compile one formula, or a loop over lanes, inlined wherever a kernel calls it."""
    return _inlined(function, fastmath={"contract"})


def exact(function: Callable[..., Any]) -> Any:
    """Compile one formula with its roundings as written."""
    # explicit, because a function without flags takes those of the caller that compiles it first
    return _inlined(function, fastmath=False)


section = scalar


def _inlined(function: Callable[..., Any], fastmath: Any) -> Any:
    options = FLAGS | {"nopython": True, "boundscheck": None, "forceinline": True, "fastmath": fastmath}
    options["no_cpython_wrapper"] = True
    return InlinedFunction(function, None, options, _InlinedCompiler) if JIT_ENABLED else function


class InlinedFunction(CPUDispatcher):  # type: ignore[misc]
    """A function without machine code outside the kernels that call it; Python calls a copy, made when it does."""

    _copy: Any = None

    def __call__(self, *arguments: Any) -> Any:
        if self._copy is None:
            self._copy = CPUDispatcher(self.py_func, None, self.targetoptions | {"no_cpython_wrapper": False})
        return self._copy(*arguments)


class _InlinedCompiler(CompilerBase):  # type: ignore[misc]
    """Numba's compiler, with another library for the code."""

    def define_pipelines(self) -> Any:
        n_done, n_functions = _progress
        if n_done < n_functions:  # in a kernel, which comes last
            _report_progress(min(n_done + 1, n_functions - 1), n_functions)
        self.state.library = _InlinedLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return [DefaultPassBuilder.define_nopython_pipeline(self.state)]


class _InlinedLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code to inline, for which no machine code is emitted: a fifth of a compilation."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    @property
    def codegen(self) -> Any:
        """Where Numba puts the environment of the function, which without machine code has no place."""
        return self

    def set_env(self, *_: Any) -> None:
        """Leave it to the kernel."""


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a loop, cached on disk under the fingerprint of everything it was compiled from."""
    compiled = numba.njit(**FLAGS, fastmath=False)(function)
    if JIT_ENABLED:
        compiled._compiler.compile = observed_compile(compiled._compiler.compile, function)
        folder = kernel_folder(fingerprint())
        if folder is not None:
            compiled._cache = KernelCache(function, folder)
    return compiled


compilation_observers: list[Callable[[int, int], None]] = []
"""Receive how many of how many functions of a kernel are compiled: from 0, when it begins, to all, when it ends."""
_progress = [0, 0]  # of the kernel that is being compiled


def _report_progress(n_done: int, n_functions: int) -> None:
    _progress[:] = n_done, n_functions
    for observe in compilation_observers:
        observe(n_done, n_functions)


def observed_compile(compile: Callable[..., Any], function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap the compiling of ``function`` to report its progress, and to spare the scans of the garbage collector."""

    def wrapper(*arguments: Any) -> Any:
        with global_compiler_lock:  # one after another, so that each restores the threshold of the user
            before = gc.get_threshold()
            if before[0]:
                gc.set_threshold(max(20_000, before[0]), *before[1:])
            n_functions = 1 + sum(not each.overloads for each in _inlined_functions(function))
            _report_progress(0, n_functions)
            try:
                with widest_vectors():
                    return compile(*arguments)
            finally:
                _report_progress(n_functions, n_functions)
                gc.set_threshold(*before)

    return wrapper


def _inlined_functions(function: Callable[..., Any]) -> set[InlinedFunction]:
    """Return the functions that are inlined into a kernel, directly or not."""
    functions, unread = set[InlinedFunction](), [function]
    while unread:
        scope = inspect.getclosurevars(unread.pop())
        values = [*scope.nonlocals.values(), *scope.globals.values()]
        values += [getattr(value, name, None) for value in values if inspect.ismodule(value) for name in scope.unbound]
        found = {value for value in values if isinstance(value, InlinedFunction)} - functions
        functions |= found
        unread += [each.py_func for each in found]
    return functions


@contextmanager
def widest_vectors() -> Iterator[None]:
    """Allow vectors of 512 bits in loops over lanes, which do not change the numbers, if this machine has them."""
    codegen = cpu_target.target_context.codegen()
    before, cpu, features = codegen._tm, codegen._get_host_cpu_name(), codegen._tm_features
    if "+avx512f" in features.split(","):
        target = llvmlite.binding.Target.from_triple(llvmlite.binding.get_process_triple())
        codegen._tm = target.create_target_machine(cpu=cpu, features=f"{features},-prefer-256-bit")
    try:
        yield
    finally:
        codegen._tm = before


if JIT_ENABLED:

    @intrinsic
    def fma(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
        """a*b + c, rounded once."""
        float64 = numba.types.float64

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            args = [context.cast(builder, x, t, float64) for x, t in zip(args, signature.args, strict=True)]
            return builder.fma(*args)

        return float64(a, b, c), codegen

else:

    def fma(a: float, b: float, c: float) -> float:  # type: ignore[misc]
        """a*b + c, rounded twice: close enough for the interpreter, which promises no bits."""
        return a * b + c


@cache
def model_sha256() -> str:
    """Hash of the sources that decide the results of a simulation; the kernel cache is not one of them."""
    digest = hashlib.sha256()
    package = Path(__file__).parents[1]
    tables = ("parameter_table.py", "parameters.toml", "metric_table.py", "outputs.toml")
    files = (*tables, "hunting.py", "physics.py", "control.py", "valve_test.py")
    for part in (*files, "numerics", "estimators", "engine"):
        for source in sorted((package / part).rglob("*.py")) or [package / part]:
            if source.name != "kernel_cache.py":
                digest.update(source.relative_to(package).as_posix().encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()


@cache
def fingerprint() -> str:
    """Hash of everything that decides what a compiled kernel does: Numba looks at the kernel's own file alone."""
    settings = [model_sha256(), sys.version, *(f"{name}={value}" for name, value in numeric_environment().items())]
    settings += [f"{k}={v}" for k, v in sorted(os.environ.items()) if k.startswith("NUMBA_") and k != "NUMBA_CACHE_DIR"]
    return hashlib.sha256("\n".join(settings).encode()).hexdigest()[:16]


def numeric_environment() -> dict[str, str]:
    """Return what the bits of a result depend on besides the sources: processor, libraries, compiler settings."""
    features = llvmlite.binding.get_host_cpu_features().flatten()
    return {
        "machine": platform.machine(),
        "cpu": llvmlite.binding.get_host_cpu_name(),
        "cpu_features": hashlib.sha256(features.encode()).hexdigest()[:16],
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "numpy": np.__version__,
        **{f"numba_{name.lower()}": str(getattr(config, name, None)) for name in _NUMBA_SETTINGS},
    }
