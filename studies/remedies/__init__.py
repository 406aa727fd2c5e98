"""Which remedy to take.

Read ``runs`` (simulations), ``tables``, ``front`` (gains of their own, the choice), ``remedies`` (gains as found, real
valves, ``main``).
"""
