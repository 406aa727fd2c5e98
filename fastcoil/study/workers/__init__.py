"""The workers that run shards, and what happens when one dies.

Read ``pools`` first: it hands shards to threads, processes or dask and finds the scenarios that kill.  ``worker`` is
what a worker runs: one shard.  ``reduce`` runs a study's own reduction of traces and checks what it returns.
"""
