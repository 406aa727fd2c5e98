"""Loops, the days that act on them, their simulation, and results as Datasets and NetCDF files.

Read ``loop`` (``Loop``; ``assignment`` checks its values, ``presets`` and ``keywords`` name them) and ``boundary``;
then ``plan`` (a validated simulation; ``clashes`` and ``stability`` refuse, ``scenarios`` numbers), ``shards``,
``running`` and ``simulate``.  ``dataset``, ``labels`` and ``provenance`` describe results; ``netcdf`` and
``stored_file`` keep them on disk, ``netcdf_probe`` is the child process that tries unknown files.
"""
