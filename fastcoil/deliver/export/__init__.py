"""What is taken to a live loop: the controller as C, Structured Text and Python, with vectors that prove a port.

Read ``export`` and ``controller`` first: a loop becomes laws in Python.  ``translate`` writes the rules among them from
the functions that the kernel runs, with ``statements``, ``values`` and ``symbols`` (from the top down), ``trees`` and
``python``.  ``source`` takes the laws apart; ``c`` and ``st``, with ``expressions``, say them in the other languages.
``record`` and ``vectors`` make what a port must answer.
"""
