"""The folder of a study: every file in it, written so that a kill at any moment loses nothing that was finished.

Read ``folder`` first, for the files by name and the lock, then ``manifest`` (``run.json``: what is run), ``shards``
(a file for each finished part, named by its hash), ``result_files`` (``results.nc`` and the traces), ``results`` (what
has been computed so far, opened or matched with a larger study), ``merge`` (from the parts to ``results.nc``) and
``verify`` (everything checked).
"""
