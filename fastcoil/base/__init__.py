"""What every other subpackage uses; it imports none of them, and neither numba nor xarray.

``errors`` (exceptions and exit codes), then ``files`` (atomic writes) and ``arguments`` (checks of public arguments);
``arrays`` has types of arrays, ``text`` formats values, ``results`` is the base class of results, ``figures`` the
style and the files of figures, ``progress`` and ``machine`` what long work needs to know.
"""
