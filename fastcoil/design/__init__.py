"""Design by theory: linear analysis, limit cycles, an explanation of hunting, and the tuning of a population.

Read ``plants`` (rest, response, open loop), ``operating_points``, ``linearise`` (margins, SIMC, lambda, Ziegler and
Nichols) and ``frequency_figures`` (bode, nyquist); ``describing_function`` and ``limit_cycle``; then ``phase_budget``,
``cures``, ``answer``, ``explanation_figure`` and ``explain``.  Tuning goes from ``search_space``, ``measures``,
``search`` and ``population`` over ``tuning_plan`` and ``kept_tunings`` to ``tuning_result`` and ``tune``.
"""
