"""What is taken to a live loop: the controller as C, Structured Text and Python, with vectors that prove a port.

Read ``export`` and ``controller`` first: a loop becomes laws in Python.  ``translate`` writes the rules among them from
the functions that the kernel runs into one function each, with ``formulas``, ``variables`` and ``values`` (from the top down) and ``python``.
``source`` takes the laws apart; ``c`` and ``st``, with ``printer``, say them in the other languages.  ``vectors`` makes
what a port must answer.
"""
