"""The ground floor of the compiled half: compiler flags, elementary functions, random numbers.  No physics.

Read ``jit`` first, every compiler flag and its reason; ``elementary`` (exp, log, sine) and ``noise`` are called by
kernels; ``stages`` and ``compile_user_function`` compile what is chosen at run time; ``kernel_cache`` keeps what was
compiled.
"""
