"""What is taken to a live loop: the controller as C, Structured Text and Python, with vectors that prove a port.

Read ``export`` and ``controller`` first: a loop becomes laws in Python.  ``translate`` writes each rule among them as
one function, from the functions that the kernel runs, with ``formulas``, ``values`` and ``words``.  ``printer``
takes the laws apart; ``languages`` writes them in C and Structured Text; ``export`` packs them as FMU and as XML too.
``vectors`` makes the answers required of a port.
"""
