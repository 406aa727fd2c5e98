"""Thousands of loops side by side: the scalar formulas of ``physics`` and ``control`` over blocks of lanes.

Read ``emulator``, the loop, first; then what it calls, in the order of a step: ``controller``, ``plant``, ``metrics``;
``rules`` (estimators and laws of a user); ``rows``, the state; ``lanes``, which cuts scenarios into blocks and runs
them.  ``at_rest`` and ``recorded`` march parts of the loop: the plant in steady state, and parts on recorded signals.
"""
