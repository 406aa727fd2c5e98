"""Design by theory: linear analysis, limit cycles, an explanation of hunting, and the tuning of a population.

Read ``plants`` (rest, response, open loop), ``operating_points``, ``linearise`` (margins, SIMC);
``describing_function`` and ``limit_cycle``; then ``prediction``, ``advice`` and ``explain``.  Tuning goes from
``measures`` over ``tuning_plan`` to ``tuning_result`` and ``tune``, the search.
"""
