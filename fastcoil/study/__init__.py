"""Studies: from a TOML file to a folder with results, and their evaluation.

``file`` reads and checks the study file; ``run`` decides what is left to do, has the ``workers`` run it shard by shard
and merges it in the ``folder``.  ``maintenance`` answers for a folder (status, verify, rerun, one scenario),
``analysis`` compares results.
"""
