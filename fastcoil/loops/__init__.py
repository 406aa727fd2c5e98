"""Loops, the days that act on them, their simulation, and results as Datasets and NetCDF files.

Read ``loop`` (``Loop``; ``assignment`` checks its values, ``presets`` and ``keywords`` name them) and ``boundary``;
then ``scenarios`` (their numbers, their days, their results as a Dataset), ``clashes`` (what is refused), ``plan`` (a
validated simulation, cut into shards) and ``simulate``.  ``labels`` and ``provenance`` describe results, ``netcdf``
keeps them on disk, ``netcdf_probe`` is the child process that tries unknown files.
"""
