"""Basis of the compiled code: compiler flags, elementary functions, random numbers.  No physics.

Read ``jit`` first, every compiler flag and its reason; ``elementary`` (exp, log, sine) and ``noise`` are called by
kernels; ``stages`` and ``compile_user_function`` compile rules and features at run time; ``kernel_cache`` stores
compiled code.
"""

from fastcoil.base.errors import settings_errors

with settings_errors("numba", "correct the environment variables NUMBA_… or the file .numba_config.yaml"):
    import numba  # noqa: F401
