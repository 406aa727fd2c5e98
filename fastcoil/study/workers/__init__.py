"""The workers that run shards, and what happens when one dies.

Read ``dispatch`` first: it hands shards to a pool and finds the scenarios that kill.  ``pools`` has the pools: threads,
processes, dask.  ``worker`` is what a worker runs: one shard.  ``user_code`` and ``reduce`` run code that comes with a
study and check what it returns.
"""
