"""Design by theory: linear analysis, limit cycles, an explanation of hunting, and the tuning of a population.

Read ``plants`` (rest, response, open loop), ``operating_points``, ``linearise`` (margins, SIMC, lambda, Ziegler and
Nichols) and ``nyquist_figure``; ``describing_function`` and ``limit_cycle``; then ``prediction``,
``advice`` and ``explain``.  Tuning goes from ``measures`` and ``search`` over ``tuning_plan`` to ``tuning_result``
and ``tune``.
"""
