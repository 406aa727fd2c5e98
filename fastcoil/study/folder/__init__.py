"""The folder of a study: every file in it, written so that a kill at any moment loses nothing that was finished.

Read ``folder`` first, for the files by name and the lock, then ``stored`` (the files with a hash: ``run.json``, shards,
``results.nc``, traces), ``merged`` (a run: its shards, and how they become results), ``state`` (what a folder holds and
what is left to do) and ``results`` (results are opened and checked).

The commit protocol: a shard is written to a temporary file, flushed, renamed to a name that contains its SHA-256, and
its folder flushed (``base.files.write_atomically``, called by ``Shards.commit``).  A run that goes on takes every shard
whose bytes match its name and computes the others; ``publish_results`` writes ``results.nc`` in the same way,
``run.json`` records its hash, and only then are the shards removed.
"""
