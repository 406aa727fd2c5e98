"""The log of an air handler, with all its valves: `inspect`.

In reading order: ``series`` (sample by sample), ``finding``, ``faults``, ``hunting``, ``unit`` (the result) and
``inspect``.
"""
