"""The log of an air handler, with all its valves: `inspect`.

In reading order: ``series`` (sample by sample), ``finding``, ``mismatch``, ``faults``, ``hunting``, ``unit`` (the
result) and ``inspect``.
"""
