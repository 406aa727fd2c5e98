"""How large the buffer of an inverse should be.

Read ``rule`` (formulas), ``runs`` (simulations), ``bounds`` (one against the other), ``buffer`` (costs, ``main``).
"""
