"""Export of a controller as C, Structured Text, Python, FMU and XML, with vectors to verify a port.

Read ``export`` and ``controller`` first: a loop becomes laws in Python.  ``translate`` makes one function of each rule
in them, from the functions that the kernel runs, with ``formulas``, ``values`` and ``words``.  ``printer`` parses the
laws; ``languages`` prints them in C and Structured Text.  ``vectors`` makes the expected answers.
"""
