"""Whether an imperfect inverse helps, also against the best plain PI.

``robustness``: tables of ``robustness.toml``; ``best_pi``: best gains and those of SIMC, which other studies use.
"""
